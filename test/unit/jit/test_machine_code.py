# SPDX-License-Identifier: Apache-2.0
"""Machine code written by hand becomes a function, with the addresses that it needs filled in."""

from __future__ import annotations

import ctypes
import pickle
from typing import Any

import numpy as np
import pytest

from tactile_hand_ros.jit import compiled
from tactile_hand_ros.jit.machine_code import ENVIRONMENT, NDARRAY, Code, address_of, function_of

# For Linux on x86-64.
_LOAD = bytes.fromhex("48 A1") + bytes(8)  # mov rax, [address]
_TAKE = bytes.fromhex("48 FF 00 C3")  # inc qword [rax]; ret: return a new reference


def code(*places: tuple[int, int, int], names: tuple[str, ...], **constants: Any) -> Code:
    """Return a function that returns the object at the address in its place 6.

    It begins behind four bytes that must not run; 24 is a word of its own.
    """
    image = b"\xcc" * 4 + _LOAD + _TAKE
    image += bytes(24 - len(image)) + bytes(8)
    at, symbols, addends = np.array(places, dtype=np.int64).T.copy()
    return Code(image, 4, at, symbols, addends, names, pickle.dumps(constants))


@pytest.mark.parametrize(
    ("symbol", "thing"),
    [("PyExc_TypeError", TypeError), (NDARRAY, np.ndarray), ("_Py_NoneStruct", None)],
)
def test_code_reads_its_own_words_and_objects_of_python(symbol: str, thing: Any) -> None:
    """The word holds an address, and the instruction that of the word."""
    own, outside = (6, -1, 24), (24, 1, 0)
    made = function_of(code(own, outside, names=("PyExc_OSError", symbol)), "made")
    assert made() is thing and made(1, 2) is thing
    assert made.__name__ == "made"
    with pytest.raises(TypeError, match="no keyword arguments"):
        made(x=1)


def test_code_finds_the_constants_of_its_function() -> None:
    """They are the fourth word of an environment."""
    names = (ENVIRONMENT + "other", ENVIRONMENT + "mine")
    both = {"mine": [1, "x"], "other": [2]}
    for index, expected in ((0, [2]), (1, [1, "x"])):
        made = function_of(code((6, index, 24), names=names, **both), "made")
        assert made() == expected
    word = function_of(code((6, -1, 24), (24, 1, 0), names=names, **both), "made")
    pointer = id(word())
    assert ctypes.c_int64.from_address(pointer).value >= 1  # it counts its references


def test_code_that_needs_what_is_nowhere_stays_python() -> None:
    broken = code((6, 0, 0), names=("no_such_symbol",))
    with pytest.raises(LookupError, match="needs 'no_such_symbol', which neither Numba nor the"):
        function_of(broken, "made")

    def plain() -> int:
        return 3

    assert compiled._loaded(broken, plain) is plain
    loaded = compiled._loaded(code((6, -1, 24), (24, 0, 0), names=("PyExc_KeyError",)), plain)
    assert loaded() is KeyError and loaded.__name__ == "plain"  # type: ignore[comparison-overlap]


def test_symbols_are_those_of_python_numba_and_the_system() -> None:
    library = ctypes.CDLL(None)
    for symbol in ("PyLong_FromLong", "malloc"):
        expected = ctypes.cast(getattr(library, symbol), ctypes.c_void_p).value
        assert address_of(symbol) == expected
    assert address_of("NRT_Allocate") > 0 and address_of("numba_unpickle") > 0
    assert address_of("numba_unpickle") == address_of("unpickle")
