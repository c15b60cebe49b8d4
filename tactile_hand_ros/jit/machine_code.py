# SPDX-License-Identifier: Apache-2.0
"""Machine code that Numba has made, and how it becomes a function again without Numba.

Loading Numba takes half a second of processor time, more than everything else that a node loads.
What its code needs while it runs is small: memory and errors, from two of Numba's C extensions, and
BLAS, from one of SciPy's. These are loaded alone, without the packages around them.
"""

from __future__ import annotations

import builtins
import ctypes
import functools
import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.extension import load_extension

ENVIRONMENT = "environment:"
"""Prefix of the symbols that stand for the Python objects of a function."""

NDARRAY = "numpy_ndarray"
"""Symbol for the class of arrays."""

_READ, _WRITE, _EXECUTE = 1, 2, 4  # of mprotect
_PRIVATE, _ANONYMOUS = 2, 32  # of mmap, on Linux
_POSITIONAL = 1  # METH_VARARGS

_OBJECTS = {"_Py_NoneStruct": None, NDARRAY: np.ndarray}


class Code(NamedTuple):
    """One function, laid out in memory, with the places where addresses are still missing.

    Attributes:
        image: Instructions and constants.
        entry: Where in the image the function begins that CPython calls.
        places: Where 8-byte addresses belong, shape (n,).
        symbols: Whose address it is, an index into `names`; -1 is the image itself; shape (n,).
        addends: What is added to that address, shape (n,).
        names: Symbols outside the image.
        constants: The Python objects that the function uses, pickled, by its environments.
    """

    image: bytes
    entry: int
    places: NDArray[np.int64]
    symbols: NDArray[np.int64]
    addends: NDArray[np.int64]
    names: tuple[str, ...]
    constants: bytes


class _Method(ctypes.Structure):
    """CPython's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


def function_of(code: Code, name: str) -> Callable[..., Any]:
    """Return the function; it takes exactly the kinds of arguments that it was compiled for.

    Raises:
        OSError: If there is no memory for it, or none that may be executed.
        LookupError: If something that it needs is not there.
    """
    environments = {
        ENVIRONMENT + own: _environment(objects)
        for own, objects in pickle.loads(code.constants).items()
    }
    base = _allocate(len(code.image))
    known = [environments.get(symbol) or address_of(symbol) for symbol in code.names]
    addresses = np.array([*known, base], dtype=np.int64)  # -1 is the last of them
    image = np.ctypeslib.as_array((ctypes.c_uint8 * len(code.image)).from_address(base))
    image[:] = np.frombuffer(code.image, dtype=np.uint8)
    filled = addresses[code.symbols] + code.addends
    image[code.places[:, None] + np.arange(8)] = filled.view(np.uint8).reshape(-1, 8)
    _check(_libc().mprotect(base, len(code.image), _READ | _EXECUTE) == 0)
    return _callable(name, base + code.entry)


def _callable(name: str, address: int) -> Callable[..., Any]:
    """Return the Python function that runs machine code."""
    method = _Method(name.encode(), address, _POSITIONAL, None)
    _keep(method)
    new = ctypes.pythonapi.PyCFunction_NewEx
    new.argtypes, new.restype = (ctypes.c_void_p,) * 3, ctypes.py_object
    made: Callable[..., Any] = new(ctypes.addressof(method), None, None)
    return made


def _environment(objects: list[Any]) -> int:
    """Return the address of what Numba's code takes for an object with globals and constants."""
    globals_: dict[str, Any] = {}
    held = (ctypes.c_void_p * 4)(1, id(object), id(globals_), id(objects))
    _keep((held, globals_, objects))
    return ctypes.addressof(held)


def _keep(thing: Any) -> None:
    """Never free what code points to, not even at exit, where functions may outlive modules."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing))


def _allocate(size: int) -> int:
    """Return the address of memory that may be written and stays for good."""
    flags = _PRIVATE | _ANONYMOUS
    address: int = _libc().mmap(None, size, _READ | _WRITE, flags, -1, 0) or 0
    _check(address not in (0, ctypes.c_void_p(-1).value))
    return address


def _check(well: bool) -> None:
    if not well:
        raise OSError(ctypes.get_errno(), "no memory that code may be executed in")


@functools.cache
def _libc() -> ctypes.CDLL:
    library = ctypes.CDLL(None, use_errno=True)
    library.mmap.restype = ctypes.c_void_p
    library.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long)
    library.mprotect.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return library


def address_of(symbol: str) -> int:
    """Return where a symbol is, as Numba would have it.

    Raises:
        LookupError: If it is nowhere.
    """
    if symbol in _OBJECTS:
        return id(_OBJECTS[symbol])
    if symbol.startswith("PyExc_"):
        return id(getattr(builtins, symbol.removeprefix("PyExc_")))
    helpers = _helpers()
    if symbol in helpers:
        return helpers[symbol]
    for library in (ctypes.pythonapi, _libc()):
        if hasattr(library, symbol):
            return ctypes.cast(getattr(library, symbol), ctypes.c_void_p).value or 0
    raise LookupError(f"compiled code needs '{symbol}', which neither Numba nor the system has")


@functools.cache
def _helpers() -> dict[str, int]:
    """Return the addresses of the C functions that Numba's code calls."""
    common = load_extension("numba", "_helperlib").c_helpers
    memory = load_extension("numba", "core/runtime/_nrt_python")
    memory.memsys_use_cpython_allocator()  # as Numba does, should it be loaded later
    for name in ("cython_blas", "cython_lapack"):  # what those C functions ask for by name
        load_extension("scipy", f"linalg/{name}", is_shared=True)
    return {
        **common,
        **{f"numba_{name}": address for name, address in common.items()},
        **{f"NRT_{name}": address for name, address in memory.c_helpers.items()},
    }
