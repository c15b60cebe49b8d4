# SPDX-License-Identifier: Apache-2.0
"""Compile numeric functions where Numba is installed; the same source runs without it.

What is marked with `compiled` is plain Python on arrays and scalars. `closed_loop.warm_up` has
Numba compile all of it once and keeps the machine code, which other processes load without Numba.
The code that is kept belongs to the sources of all compiled functions together, to the processor
and to the versions of the libraries. Where there is none, Numba compiles in the process itself.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tactile_hand_ros.files import replace_bytes
from tactile_hand_ros.jit.machine_code import Code, function_of

F = TypeVar("F", bound=Callable[..., Any])

DISABLE = "TACTILE_HAND_INTERPRETED"
_NUMERIC_FOLDERS = ("hand", "control", "simulation")
_MADE_BY = {"numba": "_version.py", "scipy": "version.py", "numpy": "version.py"}

_interpreted = False
_by_numba: dict[str, Any] = {}  # what Numba compiles in this process


def compiled(function: F) -> F:
    """Compile a function where that is possible and wanted."""
    if _interpreted or os.environ.get(DISABLE) or not _has_numba():
        return function
    code = _kept().get(_name(function))
    return _with_numba(function) if code is None else _loaded(code, function)


def run_interpreted() -> None:
    """Run as plain Python what is imported from now on: for a process that rarely calls it."""
    global _interpreted
    _interpreted = True


def is_complete() -> bool:
    """Return whether the code of everything is kept, or nothing is to be compiled."""
    file = code_file()
    return file is None or file.is_file()


def keep(run: Callable[[], None]) -> None:
    """Have Numba compile everything that a run calls, and keep the code for other processes.

    Where code cannot be loaded without Numba, as on another processor, nothing of it is kept, and
    each process lets Numba load its own cache.
    """
    from tactile_hand_ros.jit.export import UnknownCodeError, export, is_exportable

    file = code_file()
    if file is None:
        return
    if is_exportable() and _strict():
        for dispatcher in _by_numba.values():  # what comes from its cache lacks what it calls
            dispatcher._cache.disable()
    run()
    codes = {}
    with contextlib.suppress(UnknownCodeError):
        if _strict():
            codes = {name: export(dispatcher) for name, dispatcher in _by_numba.items()}
    with contextlib.suppress(OSError):  # no directory to keep it in
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_bytes(file, pickle.dumps(codes))


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


def code_file() -> Path | None:
    """Return where the code for the present sources is kept; None where nothing is compiled."""
    if os.environ.get(DISABLE) or not _has_numba():
        return None
    return _directory(os.environ.get("NUMBA_CACHE_DIR", "")) / f"code-{_maker()}"


@functools.cache
def _kept() -> dict[str, Code]:
    """Return the code of all functions by their names; empty where there is none."""
    file = code_file()
    with contextlib.suppress(OSError):
        if file is not None:
            codes: dict[str, Code] = pickle.loads(file.read_bytes())
            return codes
    return {}


def _loaded(code: Code, function: F) -> F:
    """Return a function of machine code; other kinds of arguments run as plain Python."""
    try:
        native = function_of(code, function.__name__)
    except (OSError, LookupError):  # where memory may not be executed, Numba cannot help either
        return function

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        try:
            return native(*arguments)
        except (TypeError, SystemError):  # of another kind than it was compiled for
            return function(*arguments)

    return call  # type: ignore[return-value]


def _with_numba(function: F) -> F:
    import numba

    chosen = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_directory(chosen))
    try:
        made = _jit(function)
    finally:
        numba.config.CACHE_DIR = chosen
    _by_numba[_name(function)] = made
    return made


def _jit(function: F) -> F:
    import numba

    # It would advise copies of arrays, wherever a product of a column is compiled.
    warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)
    # numpy's rules for division by zero; no reordering of sums, so that runs repeat to the bit.
    options = {"error_model": "numpy", "fastmath": False, **_strict()}
    try:
        made: F = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no directory to keep the result in
        made = numba.njit(**options)(function)
    return made


@functools.cache
def _strict() -> dict[str, Any]:
    """Return the option for wrappers that need no dispatcher; empty for another Numba's inside."""
    try:
        from tactile_hand_ros.jit.wrappers import StrictCompiler
    except ImportError:
        return {}
    return {"pipeline_class": StrictCompiler}


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


@functools.cache
def _has_numba() -> bool:
    return importlib.util.find_spec("numba") is not None


@functools.cache
def _directory(chosen: str) -> Path:
    """Return where results for the present sources are kept, below `chosen` if not empty."""
    here = Path(__file__).parent
    texts = [path.read_bytes() for path in _numeric_sources()]
    digest = hashlib.sha256(b"".join(text for text in texts if b"jit.compiled" in text))
    for path in sorted(here.glob("*.py")):
        digest.update(path.read_bytes())
    base = Path(chosen) if chosen else here / "__pycache__"
    if not chosen and not os.access(here, os.W_OK):
        user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        base = Path(user) / "tactile_hand_ros"
    return base / f"numba-{digest.hexdigest()[:16]}"


def _numeric_sources() -> list[Path]:
    """Return the files that may hold compiled functions, in a fixed order."""
    package = Path(__file__).parents[1]
    found = [path for name in _NUMERIC_FOLDERS for path in (package / name).rglob("*.py")]
    return sorted([*package.glob("*.py"), *found])


@functools.cache
def _maker() -> str:
    """Return a digest of what machine code depends on besides its source."""
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {sys.platform}".encode())
    for package, version in _MADE_BY.items():
        spec = importlib.util.find_spec(package)
        for folder in (spec and spec.submodule_search_locations) or ():
            digest.update(Path(folder, version).read_bytes())
    with contextlib.suppress(OSError), open("/proc/cpuinfo", "rb") as file:
        lines = file.read(8192).split(b"\n\n")[0].splitlines()
        digest.update(b"".join(x for x in lines if x.startswith((b"model name", b"flags"))))
    return digest.hexdigest()[:16]
