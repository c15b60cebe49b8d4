# SPDX-License-Identifier: Apache-2.0
"""A C extension is loaded alone, once, and the package that brings it may be loaded later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.jit.extension import load_extension
from tactile_hand_ros.jit.rows import row_of

ALONE = """
import sys
from tactile_hand_ros.jit.extension import load_extension
own = load_extension("scipy", "linalg/_flapack")
assert own.dgesv and "scipy.linalg._flapack" not in sys.modules
blas = load_extension("scipy", "linalg/cython_blas", is_shared=True)
assert sys.modules["scipy.linalg.cython_blas"] is blas
assert load_extension("scipy", "linalg/cython_blas") is blas
assert "scipy.linalg" not in sys.modules
import scipy.linalg.cython_blas as again
print(again is blas)
"""


def test_it_comes_without_its_package_which_shares_it_where_it_should(tmp_path: Path) -> None:
    command = [sys.executable, "-c", ALONE]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"


@pytest.mark.parametrize("package", ["scipy", "no_such_package"])
def test_what_is_not_there_is_named(package: str) -> None:
    with pytest.raises(LookupError, match=f"{package} has no C extension 'linalg/nothing'"):
        load_extension(package, "linalg/nothing")


class Inner(Config):
    gain: float = param(0.5, "Gain")
    count: int = param(3, "Count")


class Outer(Config):
    inner: Inner = Inner()
    name: str = param("x", "Name")
    limit: float = param(2.0, "Limit")


def test_the_numbers_of_a_configuration_are_one_row() -> None:
    row = row_of(Outer(inner=Inner(gain=0.25)))
    assert row.shape == (1,) and row.dtype.names == ("inner.gain", "limit")
    assert row[0]["inner.gain"] == 0.25 and row[0]["limit"] == 2.0
