# SPDX-License-Identifier: Apache-2.0
"""Random and damaged bytes are read or refused with `MessageError`; nothing else happens."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.hostile import hostile, message_readers

from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import messages as c

LAST = 2**31 * 10**9 - 1
bounded = hostile()

READERS = message_readers()
WORDS = (b"\xff" * 4, b"\xff" * 8, b"\x7f", b"\x80", bytes(4), struct.pack("<d", 1e308))
words = st.sampled_from([*WORDS, struct.pack("<d", np.nan), struct.pack("<I", 65_536)])


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Return a change of bytes: some overwritten, some cut out, some appended."""
    places = draw(st.lists(st.tuples(st.floats(0, 1), words | st.binary(max_size=9)), max_size=4))
    end = draw(st.floats(0, 1) | st.just(1.0))
    tail = draw(st.binary(max_size=64))

    def apply(data: bytes) -> bytes:
        changed = bytearray(data)
        for place, word in places:
            at = round(place * len(data))
            changed[at : at + len(word)] = word
        return bytes(changed[: round(end * len(changed))]) + tail

    return apply


def assert_usable(stamp: int, value: Any) -> None:
    """What was read is a time that can be written, and numbers that can be squared."""
    assert 0 <= stamp <= LAST
    arrays = value if isinstance(value, (list, tuple)) else [value]
    for array in arrays:
        numbers = np.asarray(array, dtype=float)
        assert (np.isnan(numbers) | (np.abs(numbers) <= c.LARGEST_NUMBER)).all()


def read(name: str, data: bytes) -> None:
    """Read bytes as one of the messages."""
    try:
        stamp, value = READERS[name][0](data)
    except MessageError as error:
        assert len(str(error)) < 1000
    else:
        assert_usable(stamp, value)


@pytest.mark.parametrize("name", READERS)
@bounded
@given(st.binary(max_size=400))
@example(b"\x00\x01\x00\x00\x01\x00")
@example(b"\x00\x01\x00\x00" + bytes(8) + b"\xff\xff\xff\x7f")
def test_random_bytes_are_read_or_refused(name, data):
    read(name, data)
    read(name, b"\x00\x01\x00\x00" + data)


@pytest.mark.parametrize("name", READERS)
@bounded
@given(damage())
def test_only_damaged_bytes_are_refused(name, change):
    decode, good = READERS[name]
    assert_usable(*decode(good))
    read(name, change(good))
