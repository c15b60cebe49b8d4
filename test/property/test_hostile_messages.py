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

from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros.messages import conversions as c
from tactile_hand_ros.ros.messages.wire import (
    ContactsCodec,
    GripCodec,
    JointCodec,
    PoseCodec,
    SlipCodec,
    WrenchCodec,
    read_message,
)

JOINTS = ["a_1", "a_2", "b_1"]
FINGERS = ["a", "b", "c"]
FIELDS = ("position", "velocity", "effort")
LAST = 2**31 * 10**9 - 1
bounded = settings(max_examples=50, deadline=None, derandomize=True)

_states, _commands = JointCodec(JOINTS, FIELDS), JointCodec(JOINTS, ("effort",))
_contacts, _force = ContactsCodec(3), WrenchCodec("tip")
_optimal = WrenchCodec("tip", nan_allowed=True)
_any = WrenchCodec("palm", any_frame=True)
_slip, _grip = SlipCodec(FINGERS), GripCodec(FINGERS)
_three = np.array([0.5, -1.0, 2.0])
_turns = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))


def _pose(data: bytes) -> tuple[int, Any]:
    message = read_message(data, PoseStamped)
    return c.stamp_to_ns(message.header.stamp), c.pose_from_ros(message)


def _number(data: bytes) -> tuple[int, Any]:
    return 0, c.number_from_ros(read_message(data, Float64))


READERS: dict[str, tuple[Callable[[bytes], tuple[int, Any]], bytes]] = {
    "joint_states": (_states.decode, _states.encode(7, _three, _three, _three)),
    "joint_command": (_commands.decode, _commands.encode(7, _three)),
    "contacts": (_contacts.decode, _contacts.encode(np.eye(3), _turns, 7)),
    "no contacts": (_contacts.decode, _contacts.encode(np.eye(3) * np.nan, _turns * np.nan, 7)),
    "wrench": (_force.decode, _force.encode(_three, 7)),
    "optimal_force": (_optimal.decode, _optimal.encode(_three * np.nan, 7)),
    "grasp_force": (_any.decode, _force.encode(_three, 7)),
    "slip": (_slip.decode, _slip.encode(7, _three, _three)),
    "grip_state": (_grip.decode, _grip.encode(7, _three, _three, _three)),
    "desired_pose": (_pose, PoseCodec().encode(_three, _turns[0], 7)),
    "user_grasp_force": (_number, serialize_message(Float64(data=3.0))),
}
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
    read(name, change(READERS[name][1]))


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
        refused_or_usable(lambda f=field: c.JointOrder(JOINTS).read(message, f))


@bounded
@given(st.lists(numbers, min_size=7, max_size=7), st.sampled_from(["palm", "tip", ""]))
def test_any_pose_force_and_number_is_read_or_refused(values: list[float], frame: str) -> None:
    pose, wrench, contacts = PoseStamped(), WrenchStamped(), PoseArray()
    pose.header.frame_id = wrench.header.frame_id = contacts.header.frame_id = frame
    pose.pose = make_pose(values[:3], values[3:])
    wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = values[:3]
    contacts.poses = [pose.pose]
    refused_or_usable(lambda: tuple(map(np.ravel, c.pose_from_ros(pose)))[0])
    refused_or_usable(lambda: c.force_from_ros(wrench, frame="tip"))
    refused_or_usable(lambda: tuple(c.contacts_from_ros(contacts, 1)))
    refused_or_usable(lambda: c.number_from_ros(Float64(data=values[0])))
