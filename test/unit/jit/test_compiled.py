# SPDX-License-Identifier: Apache-2.0
"""Compiled functions are those of the sources that are there now."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_hand_ros import files
from tactile_hand_ros.jit import compiled

INNER = """
from tactile_hand_ros.jit.compiled import compiled

@compiled
def inner(x):
    return x + {constant}
"""
OUTER = """
from typing import NamedTuple
import numpy as np
from tactile_hand_ros.jit.compiled import compiled
from tactile_hand_ros.control.inner import inner

class Pair(NamedTuple):
    doubled: np.ndarray
    total: float

@compiled
def outer(x):
    return 10.0 * inner(x)

@compiled
def pair(rows):
    out = np.empty_like(rows)
    for i in range(len(rows)):
        for j in range(rows.shape[1]):
            out[i, j] = 2.0 * rows[i, j]
    return Pair(out, out.sum())

@compiled
def solved(rows):
    return np.linalg.solve(rows @ rows, rows)
"""
CALL = "from tactile_hand_ros.control.outer import outer; print(outer(1.0))"
KEEP = """
import numpy as np
from tactile_hand_ros.control.outer import outer, pair, solved
from tactile_hand_ros.jit.compiled import is_complete, keep
def run():
    outer(1.0), pair(np.ones((2, 3))), solved(np.eye(2))
keep(run)
print(is_complete())
"""

KEEP_ONE = """
from tactile_hand_ros.control.outer import outer
from tactile_hand_ros.jit.compiled import is_complete, keep
keep(lambda: outer(1.0))
print(is_complete())
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Write a package of our name with compiled functions in two files."""
    return written(tmp_path)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write such a package, warmed up; Numba has cached a part of it before.

    A node that starts before the warm-up fills that cache.
    """
    control = written(tmp_path_factory.mktemp("kept"))
    assert run(control, CALL) == "20.0"
    assert run(control, KEEP) == "True"
    return control


def written(folder: Path) -> Path:
    """Write the package and return its folder with compiled functions."""
    root = folder / "tactile_hand_ros"
    (root / "control").mkdir(parents=True)
    shutil.copytree(
        Path(compiled.__file__).parent, root / "jit", ignore=lambda *_: ["__pycache__", "rows.py"]
    )
    shutil.copy(files.__file__, root)
    for folder in (root, root / "control"):
        (folder / "__init__.py").touch()
    (root / "control" / "outer.py").write_text(OUTER)
    (root / "control" / "inner.py").write_text(INNER.format(constant=1.0))
    return root / "control"


def run(control: Path, code: str, **environment: str) -> str:
    """Return what a new process prints, as another run of a node would."""
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=control.parents[1],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return result.stdout.strip()


def test_a_change_in_a_called_file_is_seen_also_where_the_user_wants_results(
    package: Path, tmp_path: Path
) -> None:
    """Numba alone would keep the old inner function inside the cached outer one."""
    mine = {"NUMBA_CACHE_DIR": str(tmp_path / "mine")}
    assert run(package, KEEP_ONE, **mine) == "True"
    assert not list(package.parent.rglob("code-*"))
    assert len(list((tmp_path / "mine").rglob("code-*"))) == 1
    assert run(package, CALL, **mine) == "20.0"
    # Another length: Python takes a source of the same second and length for the one it knows.
    (package / "inner.py").write_text(INNER.format(constant="2.000"))
    assert run(package, CALL, **mine) == "30.0"


def test_the_same_source_runs_without_numba(package: Path) -> None:
    assert run(package, CALL, TACTILE_HAND_INTERPRETED="1") == "20.0"
    assert not list(package.parent.rglob("*.nbi"))


LOADED = """
import sys
import numpy as np
from tactile_hand_ros.control.outer import outer, pair, solved
rows = np.arange(6.0).reshape(2, 3)
for _ in range(1000):  # what is returned is owned by Python, and freed once
    found = pair(rows)
assert type(found).__name__ == "Pair" and found.total == 30.0
assert (found.doubled == 2.0 * rows).all() and found.doubled.flags.owndata is False
assert (solved(2.0 * np.eye(2)) == 0.5 * np.eye(2)).all()
print(outer(1.0), outer(2), sorted({"numba", "llvmlite", "scipy.linalg"} & set(sys.modules)))
"""


def test_kept_code_runs_without_loading_numba(kept: Path) -> None:
    assert run(kept, LOADED) == "20.0 30.0 []"


REFUSED = """
import numpy as np
from tactile_hand_ros.control.outer import pair
rows = np.arange(24.0).reshape(4, 6)
fixed = rows.copy()
fixed.flags.writeable = False
class Other(np.ndarray):
    pass
shifted = np.frombuffer(bytearray(b"0" * 97), np.uint8)[1:].view(np.float64).reshape(4, 3)
kinds = [rows.astype(kind) for kind in (np.int64, np.float32, ">f8")]
for given in (rows[:, ::2], rows.T, rows[None], fixed, rows.view(Other), shifted, *kinds):
    found = pair(given)
    assert (found.doubled == 2.0 * given).all() and found.doubled.dtype == given.dtype, given.dtype
for nonsense in (rows[0], None, 3.0, [[1.0]], "text"):
    try:
        found = pair(nonsense)
    except (TypeError, IndexError, AttributeError):
        continue
    raise SystemExit(f"{nonsense!r} was taken, and gave {found}")
try:
    pair(rows, rows)
except TypeError as error:
    print("rows" in str(error) or "pair" in str(error))
"""


def test_other_arguments_than_it_was_compiled_for_run_as_plain_python(kept: Path) -> None:
    """Machine code that read a strided or shorter array as its own kind would read wrong memory."""
    assert run(kept, REFUSED) == "True"


LATER = """
import sys
import numpy as np
from tactile_hand_ros.control.outer import pair, solved
kept = [pair(np.ones((3, 3))).doubled for _ in range(100)]
try:
    solved(np.zeros((2, 2)))
except np.linalg.LinAlgError as error:
    print(error)
assert "numba" in sys.modules  # it is loaded for its exceptions
import numba
import scipy.linalg
twice = numba.njit(lambda rows: 2.0 * rows)
assert (twice(kept[0]) == 4.0).all()
assert (scipy.linalg.inv(kept[0] + np.eye(3)) @ (kept[0] + np.eye(3))).trace() > 2.99
del kept
assert (pair(np.ones((2, 2))).doubled == 2.0).all()
"""


def test_numba_may_still_be_loaded_later(kept: Path) -> None:
    """An error in compiled code does that, and a user's own law may."""
    assert run(kept, LATER).startswith("Matrix is singular")


def test_code_of_another_computer_is_not_loaded(kept: Path) -> None:
    """The file's name tells for which processor and libraries it was made."""
    (file,) = kept.parent.rglob("code-*")
    complete = "from tactile_hand_ros.jit.compiled import *; print(is_complete())"
    assert run(kept, complete) == "True"
    moved = file.rename(file.with_name("code-of-another"))
    assert run(kept, complete) == "False"
    moved.rename(file)


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
import sys
from tactile_hand_ros.jit import compiled
compiled._loaded = lambda code, function: compiled.function_of(code, function.__name__)
from tactile_hand_ros.closed_loop.warm_up import run_every_block, warm_up

warm_up()
run_every_block()
print(len(compiled._kept()) > 30, len(compiled._by_numba), "numba" in sys.modules)
"""


def test_warming_up_keeps_every_function_for_the_arguments_that_it_is_called_with(
    tmp_path: Path,
) -> None:
    """What it left out would be compiled, and another layout interpreted, in the middle of a run.

    Here the way back to plain Python is blocked.
    """
    done = subprocess.run(
        [sys.executable, "-c", COVERED],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert done.stdout.split() == ["True", "0", "False"]
