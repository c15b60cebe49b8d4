# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions with Numba where it is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. Numba compiles a function when
it is first called and keeps the machine code. Each state of a file and of the files that it imports
has a directory of its own: Numba does not notice a change in another file that is called.
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

Rows = NDArray[np.void]
"""Rows of named numbers, shape (n,): one argument where compiled code reads or writes a dozen."""
Row = Any
"""One of them: a view, so that writing to it changes the array."""

DISABLE = "TACTILE_HAND_INTERPRETED"
"""Environment variable that switches Numba off."""

_PACKAGE = Path(__file__).parent
_NUMERIC = ("cholesky", "rotations", "hand", "control", "simulation")
_interpreted = False


def row_of(config: Config) -> Rows:
    """Return the real numbers of a configuration under their dotted names, shape (1,)."""
    numbers = {name: x for name, x in flatten(config).items() if isinstance(x, float)}
    return np.array([tuple(numbers.values())], dtype=[(name, np.float64) for name in numbers])


def compiled(function: F) -> F:
    """Compile a function where that is possible and wanted."""
    if _interpreted or not _has_numba():
        return function
    made: F = _compiler()(function)
    return made


def run_interpreted() -> None:
    """Run as plain Python what is imported from now on: for a process that rarely calls it."""
    global _interpreted
    _interpreted = True


def ensure_compiled(pause: Callable[[float], None] = time.sleep) -> None:
    """Let another process compile what is not compiled yet: this one need not load Numba.

    It takes a minute or two, and says so on the standard error.

    Args:
        pause: Called to wait [s]; it may raise to give up.
    """
    if is_complete():
        return
    print("compiling the numeric code, once; this takes a minute or two", file=sys.stderr)
    # In a session of its own: a Ctrl-C is for the waiting process. Should it fail, each process
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
    """Return whether everything has been compiled for these sources, or nothing is to be."""
    return not _has_numba() or _mark().is_file()


def mark_complete() -> None:
    """Note that everything has been compiled for these sources."""
    with contextlib.suppress(OSError):  # no directory to keep it in
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
    """Return where something is kept that belongs to the present state of some files."""
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
    """Return the file of a numeric module of this package, and those of all that it imports."""
    _, *parts = module.split(".")
    path = _PACKAGE.joinpath(*parts).with_suffix(".py")
    if not parts or parts[0] not in _NUMERIC or not path.is_file():
        return frozenset()
    imports = re.findall(r"^from ([\w.]+) import", path.read_text("utf-8"), re.MULTILINE)
    return frozenset([path]).union(*map(_sources, imports))


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
        numba.config.CACHE_DIR = str(_kept_in("numba", _sources(function.__module__)))
        with contextlib.suppress(RuntimeError):  # no directory to keep the result in
            made._cache = Cache(function)
        numba.config.CACHE_DIR = chosen
        return made

    return compile_one
