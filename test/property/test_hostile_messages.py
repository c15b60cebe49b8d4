# SPDX-License-Identifier: Apache-2.0
"""Random and damaged bytes are read or refused with `MessageError`; nothing else happens."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from support.messages import pose as make_pose

from studies.fuzz.targets import message_readers
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import messages as c

JOINTS = ["a_1", "a_2", "b_1"]
FIELDS = ("position", "velocity", "effort")
LAST = 2**31 * 10**9 - 1
bounded = settings(max_examples=50, deadline=None, derandomize=True)

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
        stamp, value = READERS[name].decode(data)
    except MessageError as error:
        assert len(str(error)) < 1000
    else:
        assert_usable(stamp, value)


@pytest.mark.parametrize("name", READERS)
def test_undamaged_bytes_are_read(name: str) -> None:
    decode, good = READERS[name]
    assert_usable(*decode(good))


@pytest.mark.parametrize("name", READERS)
@bounded
@given(st.binary(max_size=400))
@example(b"\x00\x01\x00\x00\x01\x00")
@example(b"\x00\x01\x00\x00" + bytes(8) + b"\xff\xff\xff\x7f")
def test_random_bytes_are_read_or_refused(name: str, data: bytes) -> None:
    read(name, data)
    read(name, b"\x00\x01\x00\x00" + data)


@pytest.mark.parametrize("name", READERS)
@bounded
@given(damage())
def test_damaged_bytes_are_read_or_refused(name: str, change: Callable[[bytes], bytes]) -> None:
    read(name, change(READERS[name].good))


numbers = st.floats() | st.sampled_from([1e308, -1e308, 1e154, 5e-324])
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=9)
names = st.lists(st.sampled_from(JOINTS) | texts, max_size=5)
arrays = st.lists(numbers, max_size=5)


def refused_or_usable(call: Callable[[], Any]) -> None:
    try:
        value = call()
    except MessageError:
        return
    assert_usable(0, value)


@bounded
@given(names | st.just(JOINTS), arrays | st.lists(numbers, min_size=3, max_size=3))
def test_any_joint_state_is_read_or_refused(given_names: list[str], values: list[float]) -> None:
    message = JointState(name=given_names, position=values, velocity=values, effort=values)
    for field in FIELDS:
        codec = c.JointCodec(JOINTS, (field,))
        refused_or_usable(lambda c=codec: c.decode(serialize_message(message))[1])


@bounded
@given(st.lists(numbers, min_size=7, max_size=7), st.sampled_from(["palm", "tip", ""]))
def test_any_pose_force_and_number_is_read_or_refused(values: list[float], frame: str) -> None:
    pose, wrench, contacts = PoseStamped(), WrenchStamped(), PoseArray()
    pose.header.frame_id = wrench.header.frame_id = contacts.header.frame_id = frame
    pose.pose = make_pose(values[:3], values[3:])
    wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = values[:3]
    contacts.poses = [pose.pose]
    refused_or_usable(lambda: c.PoseCodec().decode(serialize_message(pose))[1])
    refused_or_usable(lambda: c.WrenchCodec("tip").decode(serialize_message(wrench))[1])
    refused_or_usable(lambda: c.ContactsCodec(1).decode(serialize_message(contacts))[1])
    refused_or_usable(lambda: c.read_number(serialize_message(Float64(data=values[0]))))
