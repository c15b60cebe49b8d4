# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions where Numba is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. Numba translates it once and
keeps the result on disk, so that a process pays for loading only. Numba itself would keep it until
the function's own file changes, even when a function that it calls has changed in another file;
here the result belongs to the sources of all compiled functions together.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

DISABLE = "TACTILE_HAND_INTERPRETED"


def _without_numba(function: F) -> F:
    return function


@functools.cache
def _cache_directory(chosen: str) -> str:
    """Return where results for the present sources are kept, below `chosen` if not empty."""
    here = Path(__file__).parent
    texts = [path.read_bytes() for path in sorted(here.glob("*.py"))]
    digest = hashlib.sha256(b"".join(text for text in texts if b"core.compiled" in text))
    digest.update(Path(__file__).read_bytes())
    base = Path(chosen) if chosen else here / "__pycache__"
    if not chosen and not os.access(here, os.W_OK):
        user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        base = Path(user) / "tactile_hand_ros"
    return str(base / f"numba-{digest.hexdigest()[:16]}")


def _with_numba(function: F) -> F:
    import numba

    chosen = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _cache_directory(chosen)
    try:
        return _jit(function)
    finally:
        numba.config.CACHE_DIR = chosen


def _jit(function: F) -> F:
    import numba

    # numpy's rules for division by zero; no reordering of sums, so that runs repeat to the bit.
    options = {"error_model": "numpy", "fastmath": False}
    try:
        made: F = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no directory to keep the result in
        made = numba.njit(**options)(function)
    return made


def completeness() -> Path | None:
    """Return the file that says whether everything is compiled and kept, None without Numba."""
    if compiled is _without_numba:
        return None
    import numba

    return Path(_cache_directory(numba.config.CACHE_DIR)) / "complete"


def _choose() -> Callable[[F], F]:
    if os.environ.get(DISABLE):
        return _without_numba
    try:
        import numba  # noqa: F401
    except ImportError:
        return _without_numba
    return _with_numba


compiled = _choose()
