# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions where Numba is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. Numba translates it once and
keeps the result on disk, so that a process pays for loading only. Numba itself would keep it until
the function's own file changes, even when a function that it calls has changed in another file;
here the result belongs to the sources of all compiled functions together.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

DISABLE = "TACTILE_HAND_INTERPRETED"
_COMPLETE = "complete"
_NUMERIC_FOLDERS = ("hand", "control", "simulation")


@functools.cache
def _cache_directory(chosen: str) -> str:
    """Return where results for the present sources are kept, below `chosen` if not empty."""
    here = Path(__file__).parent
    texts = [path.read_bytes() for path in _numeric_sources()]
    digest = hashlib.sha256(b"".join(text for text in texts if b"jit.compiled" in text))
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


def run_interpreted() -> None:
    """Run as plain Python what is imported from now on: for a process that calls it hardly.

    Numba takes half a second to load, more than such a process could ever save.
    """
    global _interpreted
    _interpreted = True


def cache_directory() -> Path | None:
    """Return where what is compiled is kept, None without Numba, which need not be loaded."""
    if os.environ.get(DISABLE) or importlib.util.find_spec("numba") is None:
        return None
    return Path(_cache_directory(os.environ.get("NUMBA_CACHE_DIR", "")))


def is_complete() -> bool:
    """Return whether everything is compiled and kept, or nothing is to be compiled."""
    kept = cache_directory()
    with contextlib.suppress(OSError):
        return kept is None or (kept / _COMPLETE).read_text(encoding="utf-8") == _sources()
    return False


def mark_complete() -> None:
    """Note that everything is compiled, where it is kept at all."""
    kept = cache_directory()
    if kept is not None and kept.is_dir():
        (kept / _COMPLETE).write_text(_sources(), encoding="utf-8")


def _sources() -> str:
    """Return by what Numba knows the sources again: their places and times, not only contents."""
    return "".join(f"{path} {path.stat().st_mtime_ns}\n" for path in _numeric_sources())


def _numeric_sources() -> list[Path]:
    """Return the files that may hold compiled functions, in a fixed order."""
    package = Path(__file__).parents[1]
    found = [path for name in _NUMERIC_FOLDERS for path in (package / name).rglob("*.py")]
    return sorted([*package.glob("*.py"), *found])


def ensure_compiled() -> None:
    """Let another process compile what is not compiled yet: this one need not load Numba."""
    if is_complete():
        return
    # In a session of its own: a Ctrl-C is answered by whoever waits here. Should it fail, each
    # process compiles for itself.
    subprocess.run(
        [sys.executable, "-m", "tactile_hand_ros.closed_loop.warm_up"],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        check=False,
    )


@functools.cache
def _has_numba() -> bool:
    if os.environ.get(DISABLE):
        return False
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


_interpreted = False


def compiled(function: F) -> F:
    """Compile a function where that is possible and wanted."""
    return function if _interpreted or not _has_numba() else _with_numba(function)
