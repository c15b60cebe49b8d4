# SPDX-License-Identifier: Apache-2.0
"""Compiled functions match the present sources, and a damaged cache is repaired."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_hand_ros import compiled as module

INNER = """
from tactile_hand_ros.compiled import compiled

@compiled
def inner(x):
    return x + {constant}
"""
OUTER = """
from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.inner import inner

@compiled
def outer(x):
    return 10.0 * inner(x)
"""
CALL = "from tactile_hand_ros.control.outer import outer; print(outer(1.0))"


@pytest.fixture
def control(tmp_path: Path) -> Path:
    """Write a package of our name with compiled functions in two files; return their folder."""
    root = tmp_path / "tactile_hand_ros"
    for folder in (root, root / "control", root / "config"):
        folder.mkdir()
        (folder / "__init__.py").touch()
    shutil.copy(module.__file__, root / "compiled.py")
    (root / "config" / "model.py").write_text("Config = flatten = None\n")
    (root / "control" / "outer.py").write_text(OUTER)
    (root / "control" / "inner.py").write_text(INNER.format(constant=1.0))
    return root / "control"


def run(control: Path, code: str, **environment: str) -> tuple[str, str]:
    """Return the output and warnings of a new process, like another run of a node."""
    command, own = [sys.executable, "-c", code], {**os.environ, **environment}
    options = {"capture_output": True, "text": True, "check": True, "timeout": 120}
    result = subprocess.run(command, cwd=control.parents[1], env=own, **options)
    return result.stdout.strip(), result.stderr.strip()


def test_a_change_in_a_called_file_is_seen_also_where_the_user_wants_the_cache(control, tmp_path):
    """Numba alone would keep the old inner function inside the cached outer one."""
    mine = {"NUMBA_CACHE_DIR": str(tmp_path / "mine")}
    assert run(control, CALL, **mine) == ("20.0", "")
    assert not list(control.parent.rglob("*.nbi")) and list((tmp_path / "mine").rglob("*.nbi"))
    # With another length: Python considers a source of equal second and length unchanged.
    (control / "inner.py").write_text(INNER.format(constant="2.000"))
    assert run(control, CALL, **mine) == ("30.0", "")


def test_a_change_elsewhere_leaves_what_is_compiled_as_it_is(control):
    (control / "other.py").write_text(INNER.format(constant=5.0))
    run(control, CALL)
    kept = {path: path.stat().st_mtime_ns for path in control.parent.rglob("*.nb?")}
    (control / "other.py").write_text(INNER.format(constant="6.000"))
    assert run(control, CALL) == ("20.0", "")
    assert kept and kept == {p: p.stat().st_mtime_ns for p in control.parent.rglob("*.nb?")}


def test_the_same_source_runs_without_numba(control):
    assert run(control, CALL, TACTILE_HAND_INTERPRETED="1") == ("20.0", "")
    assert not list(control.parent.rglob("*.nbi"))


def test_without_a_place_for_the_cache_it_is_compiled_in_each_process(control):
    assert run(control, CALL, NUMBA_CACHE_DIR="/proc/nowhere") == ("20.0", "")
    assert not list(control.parent.rglob("*.nbi"))  # and none among the sources


def test_damaged_files_are_compiled_again(control):
    """Both files are damaged, and both functions are compiled again."""
    assert run(control, CALL) == ("20.0", "")
    for kind in ("*.nbi", "*.nbc"):
        inner, outer = sorted(control.parent.rglob(kind))
        inner.write_bytes(b"")
        outer.write_bytes(b"not what Numba wrote")
        assert run(control, CALL) == ("20.0", "")


def test_it_is_complete_after_a_warm_up_of_these_sources(control):
    ask = "from tactile_hand_ros.compiled import *; print(is_complete())"
    assert run(control, f"{ask}; mark_complete()")[0] == "False"
    assert run(control, ask)[0] == "True"
    assert run(control, ask, NUMBA_CACHE_DIR="elsewhere")[0] == "False"
    (control / "inner.py").write_text(INNER.format(constant="2.000"))
    assert run(control, ask)[0] == "False"
    assert run(control, ask, TACTILE_HAND_INTERPRETED="1")[0] == "True"


REGULATED = """
import numpy as np
from tactile_hand_ros.control.contact import example_touch
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.hand.joints import Joints

contacts, normal = example_touch(3)
regulator = SlipRegulator(SlipRegulatorConfig(mode="auto", maximum=500.0))
random, bent = np.random.default_rng(1), np.linspace(0.1, 0.9, 9)
out = []
for i in range(600):
    rms = 0.3 if 200 <= i < 230 or 450 <= i < 470 else 0.01
    forces = np.array([1.0, 0.0, 0.7]) + 3.0 * normal + rms * random.standard_normal((3, 3))
    forces[1, 1] *= 0.2
    joints = Joints(bent, 0.0 * bent, 0.01 * random.standard_normal(9))
    seen = forces if i != 300 else np.full((3, 3), np.nan)
    k_f = regulator.step(2_000_000 * i, joints, contacts, seen)
    out.append([k_f, regulator.needed, *regulator.learned_friction, *regulator.slip_likelihood])
    out[-1].extend(regulator.state)
assert sum(row[-1] == 2.0 for row in out) > 10  # the last contact has slipped
print(np.array(out).tobytes().hex())
"""


def test_slip_and_friction_are_the_same_numbers_without_numba(tmp_path):
    """To the bit: the readable source is the reference for its compiled version."""
    both = [
        subprocess.Popen(
            [sys.executable, "-c", REGULATED],
            cwd=tmp_path,  # here `-c` would take the tree for the installed package
            env={**os.environ, **environment},
            stdout=subprocess.PIPE,
            text=True,
        )
        for environment in ({}, {"TACTILE_HAND_INTERPRETED": "1"})
    ]
    found = [process.communicate(timeout=300)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0] and len(found[0]) > 1000
    assert found[0] == found[1]


COVERED = """
import gc
from numba.core.dispatcher import Dispatcher
from tactile_hand_ros.closed_loop.warm_up import run_every_block, warm_up

warm_up()
run_every_block()
ours = [x for x in gc.get_objects() if isinstance(x, Dispatcher)]
loaded = sum(sum(x.stats.cache_hits.values()) for x in ours)
print(loaded > 30, {x.__name__: dict(x.stats.cache_misses) for x in ours if x.stats.cache_misses})
"""


def test_after_the_warm_up_nothing_is_compiled_again(tmp_path):
    """A first process may still have to fill the cache; a second one must not."""

    def has_all() -> bool:
        command, options = [sys.executable, "-c", COVERED], {"text": True, "timeout": 600}
        printed = subprocess.check_output(command, cwd=tmp_path, **options)
        return printed.split(maxsplit=1) == ["True", "{}\n"]

    assert has_all() or has_all()


def test_waiting_for_the_compiler_can_be_given_up(monkeypatch, capsys):
    """A Ctrl-C meanwhile is answered immediately, and the compiler ends."""
    monkeypatch.setattr(module, "is_complete", lambda: False)
    waits: list[float] = []

    def pause(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        module.ensure_compiled(pause)
    assert capsys.readouterr().err.startswith("compiling the numeric code, once")
