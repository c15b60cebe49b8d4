# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions with Numba where it is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. Numba compiles a function when
it is first called and keeps the machine code. Each state of the numeric sources has a directory of
its own, because Numba does not notice when a compiled function calls one of another file that has
changed. `python -m tactile_hand_ros.closed_loop.warm_up` compiles everything ahead of a run.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, flatten

F = TypeVar("F", bound=Callable[..., Any])

Rows = NDArray[np.void]
"""Rows of named numbers, shape (n,): one argument where compiled code reads or writes a dozen."""
Row = Any
"""One of them: a view, so that writing to it changes the array."""

DISABLE = "TACTILE_HAND_INTERPRETED"
"""Environment variable that switches Numba off."""

_NUMERIC = ("hand", "control", "simulation")
_interpreted = False


def row_of(config: Config) -> Rows:
    """Return the real numbers of a configuration under their dotted names, shape (1,)."""
    numbers = {name: x for name, x in flatten(config).items() if isinstance(x, float)}
    return np.array([tuple(numbers.values())], dtype=[(name, np.float64) for name in numbers])


def compiled(function: F) -> F:
    """Compile a function where that is possible and wanted."""
    if _interpreted or cache_directory() is None:
        return function
    made: F = _compiler()(function)
    return made


def run_interpreted() -> None:
    """Run as plain Python what is imported from now on: for a process that rarely calls it."""
    global _interpreted
    _interpreted = True


def ensure_compiled() -> None:
    """Let another process compile what is not compiled yet: this one need not load Numba."""
    if is_complete():
        return
    # In a session of its own: the waiting process answers a Ctrl-C. Should it fail, each
    # process compiles for itself.
    subprocess.run(
        [sys.executable, "-m", "tactile_hand_ros.closed_loop.warm_up"],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        check=False,
    )


def is_complete() -> bool:
    """Return whether everything has been compiled for these sources, or nothing is to be."""
    directory = cache_directory()
    return directory is None or (directory / "complete").is_file()


def mark_complete() -> None:
    """Note that everything has been compiled for these sources."""
    directory = cache_directory()
    with contextlib.suppress(OSError):  # no directory to keep it in
        if directory is not None:
            directory.mkdir(parents=True, exist_ok=True)
            (directory / "complete").touch()


@functools.cache
def cache_directory() -> Path | None:
    """Return where machine code for these sources is kept; None where nothing is compiled."""
    if os.environ.get(DISABLE) or importlib.util.find_spec("numba") is None:
        return None
    package = Path(__file__).parent
    digest = hashlib.sha256(importlib.metadata.version("numba").encode())
    for path in _numeric_sources(package):
        text = path.read_bytes()
        digest.update(text if b"compiled" in text else b"")
    base = package / "__pycache__"
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        base = Path(chosen)
    elif not os.access(package, os.W_OK):
        user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        base = Path(user) / "tactile_hand_ros"
    return base / f"numba-{digest.hexdigest()[:16]}"


def _numeric_sources(package: Path) -> list[Path]:
    found = (
        path for name in _NUMERIC for path in (package / name, *(package / name).rglob("*.py"))
    )
    return sorted(path for path in found if path.is_file())


@functools.cache
def _compiler() -> Callable[[Any], Any]:
    """Return what compiles a function; loading Numba takes half a second."""
    import numba
    from numba.core.caching import FunctionCache

    class Cache(FunctionCache):
        """Numba's cache, where a damaged file means to compile again, and a full disk nothing."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            try:
                return super().load_overload(sig, target_context)
            except Exception:  # unpickling damaged bytes may raise anything
                _warn_of_damage()
                with contextlib.suppress(OSError):
                    self.flush()
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            with contextlib.suppress(OSError):
                super().save_overload(sig, data)

    # It would advise copies of arrays, wherever a product of a column is compiled.
    warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)
    # numpy's rules for division by zero; no reordering of sums, so that runs repeat to the bit.
    jit = numba.njit(error_model="numpy", fastmath=False)

    def compile_one(function: Any) -> Any:
        made, chosen = jit(function), numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(cache_directory())
        with contextlib.suppress(RuntimeError):  # no directory to keep the result in
            made._cache = Cache(function)
        numba.config.CACHE_DIR = chosen
        return made

    return compile_one


@functools.cache
def _warn_of_damage() -> None:
    text = f"{cache_directory()}: damaged machine code is compiled again"
    warnings.warn(text, RuntimeWarning, stacklevel=2)
