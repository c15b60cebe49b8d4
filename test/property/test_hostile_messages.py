# SPDX-License-Identifier: Apache-2.0
"""Random and damaged bytes are read or refused with `MessageError`; nothing else happens."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from support.hostile import hostile

from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import messages as c

LAST = 2**31 * 10**9 - 1
bounded = hostile()

FINGERS = ["finger_1", "finger_2", "finger_3"]
THREE, TURNS = np.array([0.5, -1.0, 2.0]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
NUMBER = bytes(serialize_message(Float64(data=3.0)))
JOINTS = c.JointCodec(FINGERS, ("position", "velocity", "effort"))
EFFORTS, SLIP = c.JointCodec(FINGERS, ("effort",)), c.JointCodec(FINGERS, ("position", "velocity"))
GRIP, CONTACTS = c.JointCodec(FINGERS), c.ContactsCodec(3)
FORCE, OPTIMAL = c.WrenchCodec("tip"), c.WrenchCodec("tip", nan_allowed=True)
READERS = {
    "joints": (JOINTS.decode, JOINTS.encode(7, THREE, THREE, THREE)),
    "efforts": (EFFORTS.decode, EFFORTS.encode(7, THREE)),
    "contacts": (CONTACTS.decode, CONTACTS.encode(np.eye(3), TURNS, 7)),
    "no contacts": (CONTACTS.decode, CONTACTS.encode(np.nan * np.eye(3), np.nan * TURNS, 7)),
    "force": (FORCE.decode, FORCE.encode(THREE, 7)),
    "no force": (OPTIMAL.decode, OPTIMAL.encode(np.nan * THREE, 7)),
    "force in any frame": (c.WrenchCodec("palm", any_frame=True).decode, FORCE.encode(THREE, 7)),
    "slip": (SLIP.decode, SLIP.encode(7, THREE, THREE)),
    "grip": (GRIP.decode, GRIP.encode(7, THREE, THREE, THREE)),
    "pose": (c.PoseCodec().decode, c.PoseCodec().encode(THREE, TURNS[0], 7)),
    "push": (c.PushCodec().decode, c.PushCodec().encode(np.arange(6.0), 7)),
    "number": (lambda data: (0, c.read_number(data)), NUMBER),
}
"""Functions that return timestamp [ns] and content, or raise `MessageError`; and valid bytes."""

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
