# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions where Numba is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. Numba translates it once and
keeps the result on disk, so that a process pays for loading only.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

DISABLE = "TACTILE_HAND_INTERPRETED"


def _without_numba(function: F) -> F:
    return function


def _with_numba(function: F) -> F:
    import numba

    # numpy's rules for division by zero; no reordering of sums, so that runs repeat to the bit.
    options = {"error_model": "numpy", "fastmath": False}
    try:
        made: F = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no directory to keep the result in
        made = numba.njit(**options)(function)
    return made


def _choose() -> Callable[[F], F]:
    if os.environ.get(DISABLE):
        return _without_numba
    try:
        import numba  # noqa: F401
    except ImportError:
        return _without_numba
    return _with_numba


compiled = _choose()
