# SPDX-License-Identifier: Apache-2.0
"""Compiled functions are those of the sources that are there now."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_hand_ros.jit import compiled

INNER = """
from tactile_hand_ros.jit.compiled import compiled

@compiled
def inner(x):
    return x + {constant}
"""
OUTER = """
from tactile_hand_ros.jit.compiled import compiled
from tactile_hand_ros.control.inner import inner

@compiled
def outer(x):
    return 10.0 * inner(x)
"""
CALL = "from tactile_hand_ros.control.outer import outer; print(outer(1.0))"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Write a package of our name with two compiled functions in two files."""
    root = tmp_path / "tactile_hand_ros"
    for folder in (root, root / "jit", root / "control"):
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()
    (root / "jit" / "compiled.py").write_text(Path(compiled.__file__).read_text())
    (root / "control" / "outer.py").write_text(OUTER)
    (root / "control" / "inner.py").write_text(INNER.format(constant=1.0))
    return root / "control"


def call(control: Path, **environment: str) -> float:
    """Run the outer function in a new process, as another run of a node would."""
    result = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=control.parents[1],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return float(result.stdout)


def test_a_change_in_a_called_file_is_seen(package: Path) -> None:
    """Numba alone would keep the old inner function inside the cached outer one."""
    assert call(package) == 20.0
    # Another length: Python takes a source of the same second and length for the one it knows.
    (package / "inner.py").write_text(INNER.format(constant="2.000"))
    assert call(package) == 30.0


def test_the_same_source_runs_without_numba(package: Path) -> None:
    assert call(package, TACTILE_HAND_INTERPRETED="1") == 20.0
    assert not list(package.parent.rglob("*.nbi"))


def test_results_are_kept_where_the_user_wants(package: Path, tmp_path: Path) -> None:
    assert call(package, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == 20.0
    assert not list(package.parent.rglob("*.nbi"))


COMPLETE = "from tactile_hand_ros.jit.compiled import *; print(is_complete())"
NOTE = "from tactile_hand_ros.jit.compiled import *; mark_complete()"


def test_a_copied_or_touched_tree_is_compiled_anew(package: Path) -> None:
    """Numba knows a source by place and time: with equal contents alone nodes would compile."""

    def run(code: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=package.parents[1],
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        return done.stdout.strip()

    assert run(COMPLETE) == "False"
    assert call(package) == 20.0
    assert run(COMPLETE) == "False"
    run(NOTE)
    assert run(COMPLETE) == "True"
    os.utime(package / "inner.py", ns=(0, 0))
    assert run(COMPLETE) == "False"


REGULATED = """
import numpy as np
from tactile_hand_ros.control.rehearsal import example_touch
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig

contacts, normal = example_touch(4)
regulator = SlipRegulator(SlipRegulatorConfig(mode="auto", maximum=500.0), 4)
random = np.random.default_rng(1)
out = []
for i in range(600):
    rms = 0.3 if 200 <= i < 230 or 450 <= i < 470 else 0.01
    forces = np.array([1.0, 0.0, 0.7]) + 3.0 * normal + rms * random.standard_normal((4, 3))
    forces[2, 1] *= 0.2
    k_f = regulator.step(2_000_000 * i, contacts, forces if i != 300 else np.full((4, 3), np.nan))
    out.append([k_f, regulator.needed, *regulator.learned_friction, *regulator.slip_likelihood])
    out[-1].extend(regulator.state)
assert sum(row[-1] == 2.0 for row in out) > 10  # the last contact has slipped
print(np.array(out).tobytes().hex())
"""


def test_slip_and_friction_are_the_same_numbers_without_numba(tmp_path: Path) -> None:
    """To the bit: the readable source is the reference for what is compiled from it."""
    found = [
        subprocess.run(
            [sys.executable, "-c", REGULATED],
            cwd=tmp_path,  # here `-c` would take the tree for the installed package
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        ).stdout
        for environment in ({}, {"TACTILE_HAND_INTERPRETED": "1"})
    ]
    assert found[0] == found[1]


COVERED = """
import importlib, pkgutil
from numba.core.registry import CPUDispatcher
from tactile_hand_ros import cholesky, control, hand, rotations, simulation
from tactile_hand_ros.jit.compiled import cache_directory
from tactile_hand_ros.closed_loop.warm_up import run_every_block, warm_up

warm_up()
run_every_block()
kept = [path.name for path in cache_directory().parent.rglob("*.nbi")]
names = [cholesky.__name__, rotations.__name__]
for package in (control, hand, simulation):
    found = pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    names += [module.name for module in found]
for name in names:
    for function in vars(importlib.import_module(name)).values():
        if isinstance(function, CPUDispatcher) and function.py_func.__module__ == name:
            start = f"{name.rpartition('.')[2]}.{function.py_func.__name__}-"
            print(start, any(n.startswith(start) for n in kept), len(function.signatures))
"""


def test_warming_up_compiles_every_function_and_for_one_kind_of_arguments(tmp_path: Path) -> None:
    """What it left out, or another layout of an array, would be compiled in the middle of a run."""
    done = subprocess.run(
        [sys.executable, "-c", COVERED],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    found = [line.split() for line in done.stdout.splitlines()]
    assert len(found) > 30
    assert [name for name, is_kept, _ in found if is_kept != "True"] == []
    assert [name for name, _, kinds in found if int(kinds) > 1] == []
