# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions with Numba if it is installed; the same source runs without it.

Functions marked with `compiled` are plain Python on arrays and scalars. Numba compiles a function
at its first call and caches the machine code. Numba does not detect changes in other files that the
function uses. So each state of a file and of its imports has its own cache directory.
`python -m tactile_hand_ros.closed_loop.warm_up` compiles everything ahead of a run.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, flatten

F = TypeVar("F", bound=Callable[..., Any])

Array = NDArray[np.float64]
"""Doubles; docstrings give shape and unit."""
Rows = NDArray[np.void]
"""Rows of named numbers, shape (n,): one argument instead of a dozen for compiled code."""
Row = Any
"""One row, as a view: writing to it changes the array."""

DISABLE = "TACTILE_HAND_INTERPRETED"
"""Environment variable that switches Numba off."""

_PACKAGE = Path(__file__).parent
_NUMERIC = ("cholesky", "rotations", "hand", "control", "simulation")
_interpreted = False


def row_of(config: Config) -> Rows:
    """Return the floats of a configuration by dotted name, shape (1,)."""
    numbers = {name: x for name, x in flatten(config).items() if isinstance(x, float)}
    return np.array([tuple(numbers.values())], dtype=[(name, np.float64) for name in numbers])


def compiled(function: F) -> F:
    """Compile a function if Numba is available and not switched off."""
    if _interpreted or not _has_numba():
        return function
    made: F = _compiler()(function)
    return made


def run_interpreted() -> None:
    """Do not compile modules imported from now on, for a process that rarely calls them."""
    global _interpreted
    _interpreted = True


def ensure_compiled(pause: Callable[[float], None] = time.sleep) -> None:
    """Compile all functions in another process, so that this one need not load Numba.

    `pause` waits [s] and may raise to abort.
    """
    if is_complete():
        return
    print("compiling the numeric code, once; this takes a minute or two", file=sys.stderr)
    # In its own session, because Ctrl-C is for the waiting process. If it fails, each process
    # compiles for itself.
    command = [sys.executable, "-m", "tactile_hand_ros.closed_loop.warm_up"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        while process.poll() is None:
            pause(0.1)
    finally:
        process.kill()
        process.wait()


def is_complete() -> bool:
    """Return whether these sources are compiled, or need not be."""
    return not _has_numba() or _mark().is_file()


def mark_complete() -> None:
    """Mark these sources as compiled."""
    with contextlib.suppress(OSError):  # no writable cache directory
        if _has_numba():
            _mark().parent.mkdir(parents=True, exist_ok=True)
            _mark().touch()


@functools.cache
def _has_numba() -> bool:
    return not os.environ.get(DISABLE) and importlib.util.find_spec("numba") is not None


def _mark() -> Path:
    places = [path for name in _NUMERIC for path in (_PACKAGE / name).rglob("*.py")]
    return _kept_in("complete", [*_PACKAGE.glob("*.py"), *places])


def _kept_in(name: str, sources: Iterable[Path]) -> Path:
    """Return a cache path for the current state of some files."""
    digest = hashlib.sha256(importlib.metadata.version("numba").encode())
    for path in sorted(sources):
        digest.update(path.read_bytes())
    base = _PACKAGE / "__pycache__"
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        base = Path(chosen)
    elif not os.access(_PACKAGE, os.W_OK):
        user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        base = Path(user) / "tactile_hand_ros"
    return base / f"{name}-{digest.hexdigest()[:16]}"


@functools.cache
def _sources(module: str) -> frozenset[Path]:
    """Return the files of a numeric module of this package and of all its imports."""
    _, *parts = module.split(".")
    path = _PACKAGE.joinpath(*parts).with_suffix(".py")
    if not parts or parts[0] not in _NUMERIC or not path.is_file():
        return frozenset()
    imports = re.findall(r"^from ([\w.]+) import", path.read_text("utf-8"), re.MULTILINE)
    return frozenset([path]).union(*map(_sources, imports))


@functools.cache
def _cache_of(module: str) -> str:
    """Return the directory for compiled functions of a module; it depends on dozens of files."""
    return str(_kept_in("numba", _sources(module)))


@functools.cache
def _compiler() -> Callable[[Any], Any]:
    """Return the compile function; loading Numba takes half a second."""
    import numba
    from numba.core.caching import FunctionCache

    class Cache(FunctionCache):
        """Numba's cache, but a damaged file causes recompilation and a full disk is ignored."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            try:
                return super().load_overload(sig, target_context)
            except Exception:  # unpickling damaged bytes may raise anything
                with contextlib.suppress(OSError):
                    self.flush()
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            with contextlib.suppress(OSError):
                super().save_overload(sig, data)

    # Numba warns about every product with a column, advising a copy.
    warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)
    # NumPy's rules for division by zero; no reordering of sums, so that runs are bit-identical.
    jit = numba.njit(error_model="numpy", fastmath=False)

    def compile_one(function: Any) -> Any:
        made, chosen = jit(function), numba.config.CACHE_DIR
        numba.config.CACHE_DIR = place = _cache_of(function.__module__)
        with contextlib.suppress(OSError, RuntimeError):  # no writable directory for the result
            Path(place).mkdir(parents=True, exist_ok=True)  # else Numba takes another one
            made._cache = Cache(function)
        numba.config.CACHE_DIR = chosen
        return made

    return compile_one
