# SPDX-License-Identifier: Apache-2.0
"""Bytes written in place are those that ROS reads, and bytes of others are read as ROS would."""

import math
import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from support.messages import contacts_message, force_message, joint_message

from tactile_hand_ros.cdr import clock_bytes, header_stamp
from tactile_hand_ros.errors import MessageError, UnsafeOutputError
from tactile_hand_ros.ros.messages import conversions as c
from tactile_hand_ros.ros.messages import wire
from tactile_hand_ros.ros.messages.wire import (
    LARGEST_MESSAGE,
    ContactsCodec,
    JointCodec,
    PoseCodec,
    WrenchCodec,
)

FIELDS = ("position", "velocity", "effort")
stamps = st.integers(0, 2**31 * 10**9 - 1)
numbers = st.floats(-1e9, 1e9)
names = st.lists(st.text("abc_1é", min_size=1, max_size=9), min_size=1, max_size=9, unique=True)


def vectors(size):
    return arrays(np.float64, size, elements=numbers)


def unit_quaternions(count):
    turns = np.random.default_rng(count).normal(size=(count, 4))
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


def same_bits(ours, theirs):
    """Compare to the bit, so that -0.0 is not 0.0."""
    assert np.asarray(ours, dtype=float).tobytes() == np.asarray(theirs, dtype=float).tobytes()


@given(stamps, vectors(3), st.text("abc_1é", max_size=20))
def test_a_force_is_read_by_ros_and_by_us(stamp, force, frame):
    codec = WrenchCodec(frame)
    data = codec.encode(force, stamp)
    message = deserialize_message(data, WrenchStamped)
    assert c.stamp_to_ns(message.header.stamp) == stamp and message.header.frame_id == frame
    same_bits(c.force_from_ros(message), force)
    for received in (data, serialize_message(force_message(force, stamp, frame))):
        found, ours = codec.decode(received)
        assert found == stamp
        same_bits(ours, force)


@given(stamps, st.integers(1, 6), st.data())
def test_contacts_are_read_by_ros_and_by_us(stamp, count, data):
    positions = data.draw(vectors((count, 3)))
    quaternions = unit_quaternions(count)
    open_ = data.draw(st.lists(st.booleans(), min_size=count, max_size=count))
    positions[open_], quaternions[open_] = np.nan, np.nan
    codec = ContactsCodec(count)
    ours = codec.encode(positions, quaternions, stamp)
    theirs = serialize_message(contacts_message(positions, quaternions, stamp))
    read = c.contacts_from_ros(deserialize_message(ours, PoseArray), count)
    for stamp_read, found in ((stamp, read), codec.decode(ours), codec.decode(theirs)):
        assert stamp_read == stamp
        np.testing.assert_array_equal(found.positions, positions)
        np.testing.assert_array_equal(found.quaternions, quaternions)


@given(stamps, names, st.sets(st.sampled_from(FIELDS), min_size=1), st.data())
def test_joints_are_read_by_ros_and_by_us(stamp, joints, chosen, data):
    fields = [field for field in FIELDS if field in chosen]
    values = [data.draw(vectors(len(joints))) for _ in fields]
    codec = JointCodec(joints, fields)
    ours = codec.encode(stamp, *values)
    message = deserialize_message(ours, JointState)
    assert message.name == joints
    for field in FIELDS:
        expected = values[fields.index(field)] if field in fields else []
        same_bits(getattr(message, field), expected)
    given_fields = dict(zip(fields, values, strict=True))
    theirs = serialize_message(joint_message(joints, stamp, **given_fields))
    for received in (ours, theirs):
        found, arrays_read = codec.decode(received)
        assert found == stamp
        for read, value in zip(arrays_read, values, strict=True):
            same_bits(read, value)


@given(stamps, vectors(3))
def test_pose_and_clock_are_read_by_ros(stamp, position):
    (quaternion,) = unit_quaternions(1)
    pose = deserialize_message(PoseCodec().encode(position, quaternion, stamp), PoseStamped)
    same_bits(c.pose_from_ros(pose).position, position)
    turn = pose.pose.orientation
    same_bits([turn.x, turn.y, turn.z, turn.w], quaternion)
    assert c.stamp_to_ns(pose.header.stamp) == stamp
    clock = deserialize_message(clock_bytes(stamp), Clock)
    assert c.stamp_to_ns(clock.clock) == stamp


def test_joints_of_a_sender_with_another_order_are_sorted():
    codec = JointCodec(["a", "b", "c"], FIELDS, wanted=("position", "velocity"))
    message = JointState(name=["c", "a", "b"], position=[3.0, 1.0, 2.0], velocity=[6.0, 4.0, 5.0])
    _, (position, velocity) = codec.decode(serialize_message(message))
    np.testing.assert_array_equal(position, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(velocity, [4.0, 5.0, 6.0])


def test_a_field_that_is_not_wanted_may_be_nan():
    codec = JointCodec(["a"], FIELDS, wanted=("position",))
    message = JointState(name=["a"], position=[1.0], velocity=[np.nan], effort=[np.nan])
    _, (position,) = codec.decode(serialize_message(message))
    assert position == [1.0]


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (JointState(name=["a", "x"], effort=[1.0, 2.0]), "unknown joint 'x'"),
        (JointState(name=["a"], effort=[1.0]), "joint 'b' is missing"),
        (JointState(name=["a", "b"], effort=[1.0]), "effort has 1 values"),
        (JointState(name=["a", "b"], effort=[1.0, math.nan]), "effort of joint 'b' is nan"),
        (JointState(name=["a", "b"]), "effort has 0 values"),
    ],
)
def test_a_wrong_command_is_refused_in_words(message, words):
    with pytest.raises(MessageError, match=words):
        JointCodec(["a", "b"], ("effort",)).decode(serialize_message(message))


def test_a_force_in_another_frame_is_refused_unless_the_frame_does_not_matter():
    data = WrenchCodec("tip").encode((0.0, 7.0, 0.0), 5)
    with pytest.raises(MessageError, match="frame_id is 'tip', expected 'palm'"):
        WrenchCodec("palm").decode(data)
    stamp, force = WrenchCodec("palm", any_frame=True).decode(data)
    assert stamp == 5 and force[1] == 7.0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e300])
def test_a_force_that_is_no_number_is_refused_and_not_sent(wrong):
    data = serialize_message(force_message((0.0, wrong, 0.0), 5, "tip"))
    with pytest.raises(MessageError, match="expected three finite numbers"):
        WrenchCodec("tip").decode(data)
    with pytest.raises(UnsafeOutputError, match="not finite"):
        WrenchCodec("tip").encode((0.0, wrong, 0.0), 5)


def test_nan_can_be_an_answer_but_not_infinity_or_another_frame():
    codec = WrenchCodec("tip", nan_allowed=True)
    stamp, force = codec.decode(codec.encode((math.nan, 0.0, 0.0), 5))
    assert stamp == 5 and np.isnan(force).all()
    with pytest.raises(MessageError):
        codec.decode(serialize_message(force_message((math.inf, 0.0, 0.0), 5, "tip")))
    with pytest.raises(UnsafeOutputError):
        codec.encode((math.nan, math.inf, 0.0), 5)
    with pytest.raises(MessageError):
        codec.decode(serialize_message(force_message((math.nan, 0.0, 0.0), 5, "other")))


def test_wrong_contacts_are_refused():
    positions, quaternions = np.zeros((3, 3)), unit_quaternions(3)
    data = ContactsCodec(3).encode(positions, quaternions, 1)
    with pytest.raises(MessageError, match="3 contacts, expected 4"):
        ContactsCodec(4).decode(data)
    with pytest.raises(MessageError, match="length 1"):
        ContactsCodec(3).decode(ContactsCodec(3).encode(positions, 2.0 * quaternions, 1))
    positions[1, 1] = np.nan
    with pytest.raises(MessageError, match="or all NaN"):
        ContactsCodec(3).decode(ContactsCodec(3).encode(positions, quaternions, 1))


def test_a_message_is_written_with_all_its_blocks_or_not_at_all() -> None:
    """Fewer would leave numbers of an earlier message in the others."""
    joints = JointCodec(["a", "b"], ("position", "velocity"))
    with pytest.raises(ValueError, match="zip"):
        joints.encode(0, np.zeros(2))


@pytest.mark.parametrize("stamp", [0, 2_000_000, 86_399_999_999_999])
def test_stamp_is_read_from_bytes(stamp):
    data = serialize_message(joint_message(["a"], stamp))
    assert header_stamp(data) == stamp
    big_endian = bytes([0, 0, 0, 0]) + struct.pack(">iI", *divmod(stamp, 1_000_000_000))
    assert header_stamp(big_endian) == stamp


CODECS = {
    "force": WrenchCodec("tip"),
    "f*": WrenchCodec("tip", nan_allowed=True),
    "contacts": ContactsCodec(3),
    "joints": JointCodec(["a", "b"], FIELDS),
    "command": JointCodec(["a", "b"], ("effort",)),
    "slip": JointCodec(["a", "b"], ("position", "velocity")),
}


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
@pytest.mark.parametrize(
    "data",
    [b"", b"\x00", b"\x00\x01\x00\x00\x01\x00", b"\x00\x01\x00\x00" + b"\xff" * 500, bytes(10**6)],
    ids=["nothing", "a byte", "cut", "lengths", "a megabyte"],
)
def test_bytes_that_are_no_message_are_refused(codec, data):
    with pytest.raises(MessageError, match="bytes"):
        codec.decode(data)


EXTREME = [(2**31 - 1, 2**32 - 1), (0, 10**9), (-1, 0), (-(2**31), 999_999_999)]


@pytest.mark.parametrize(("seconds", "nanoseconds"), EXTREME)
def test_a_stamp_that_is_no_time_is_refused(seconds, nanoseconds):
    codec = WrenchCodec("tip")
    data = bytearray(codec.encode((0.0, 1.0, 0.0), 0))
    struct.pack_into("<iI", data, 4, seconds, nanoseconds)
    for received in (bytes(data), bytes(data) + bytes(4)):  # the second is read by ROS
        with pytest.raises(MessageError, match="the stamp is"):
            codec.decode(received)


def test_the_last_time_that_a_stamp_can_tell_is_read_and_written():
    codec = WrenchCodec("tip")
    last = 2**31 * 10**9 - 1
    assert codec.decode(codec.encode((0.0, 1.0, 0.0), last))[0] == last


def test_a_command_without_names_is_refused():
    """The first message of a sender shall not define what no names mean."""
    codec = JointCodec(["a", "b"], ("effort",))
    for effort in ([1.0, 2.0], [math.nan, 1.0], []):
        with pytest.raises(MessageError, match="joint 'a' is missing"):
            codec.decode(serialize_message(JointState(effort=effort)))


def test_no_sender_makes_an_error_long():
    long = "x" * 10_000
    joints, force = JointState(name=[long], effort=[1.0]), force_message((0, 0, 0), 0, long)
    with pytest.raises(MessageError) as unknown:
        JointCodec(["a", "b"], ("effort",)).decode(serialize_message(joints))
    with pytest.raises(MessageError) as frame:
        WrenchCodec("tip").decode(serialize_message(force))
    assert max(len(str(unknown.value)), len(str(frame.value))) < 300


BEYOND = math.nextafter(1e9, math.inf)
"""The first number that is too large for a message."""


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_part_of_a_force_counts_up_to_the_largest_number(place, sign):
    codec, force = WrenchCodec("tip"), [0.0, 0.0, 0.0]
    force[place] = sign * 1e9
    stamp, read = codec.decode(codec.encode(force, 5))
    assert (stamp, list(read)) == (5, force)
    for wrong in (sign * BEYOND, sign * 1e200):
        force[place] = wrong
        with pytest.raises(UnsafeOutputError):
            codec.encode(force, 5)
        with pytest.raises(MessageError, match="expected three finite numbers"):
            codec.decode(serialize_message(force_message(force, 5, "tip")))


def test_three_large_parts_of_a_force_are_as_good_as_one():
    """Their sum of squares is above the limit, none of them is."""
    codec, force = WrenchCodec("tip"), (9e8, -9e8, 9e8)
    assert codec.decode(codec.encode(force, 5)) == (5, force)
    joints, values = JointCodec(["a", "b", "c"], ("effort",)), np.array(force)
    np.testing.assert_array_equal(joints.decode(joints.encode(5, values))[1][0], values)


@pytest.mark.parametrize("place", range(3))
def test_any_part_that_is_nan_makes_the_answer_nan_in_the_right_frame(place):
    force = [1.0, 2.0, 3.0]
    force[place] = math.nan
    data = serialize_message(force_message(force, 5, "tip"))
    stamp, read = WrenchCodec("tip", nan_allowed=True).decode(data)
    assert stamp == 5 and len(read) == 3 and np.isnan(read).all()
    stamp, read = WrenchCodec("other", nan_allowed=True, any_frame=True).decode(data)
    assert stamp == 5 and np.isnan(read).all()
    with pytest.raises(MessageError, match="frame_id is 'tip', expected 'other'"):
        WrenchCodec("other", nan_allowed=True).decode(data)


@pytest.mark.parametrize("place", range(2))
def test_each_block_of_numbers_is_checked_before_it_is_sent(place):
    values = [np.zeros(2), np.zeros(2)]
    values[place][1] = BEYOND
    with pytest.raises(UnsafeOutputError, match="was not published"):
        JointCodec(["a", "b"], ("position", "velocity")).encode(0, *values)


@pytest.mark.parametrize("place", range(7))
def test_each_number_of_a_pose_is_checked_before_it_is_sent(place):
    numbers_ = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8])
    numbers_[place] = math.nan
    with pytest.raises(UnsafeOutputError):
        PoseCodec().encode(numbers_[:3], numbers_[3:], 5)
    numbers_[place] = math.inf
    with pytest.raises(UnsafeOutputError):
        ContactsCodec(1).encode(numbers_[None, :3], numbers_[None, 3:], 5)


def test_a_message_may_have_the_largest_size_and_not_a_byte_more():
    data = WrenchCodec("tip").encode((1.0, 2.0, 3.0), 5).ljust(LARGEST_MESSAGE, b"\0")
    assert WrenchCodec("tip").decode(data) == (5, (1.0, 2.0, 3.0))
    with pytest.raises(MessageError, match=f"{LARGEST_MESSAGE + 1} bytes, expected at most"):
        WrenchCodec("tip").decode(data + b"\0")


@pytest.mark.parametrize("size", range(13))
def test_a_stamp_needs_twelve_bytes(size):
    data = clock_bytes(7_000_000_008)[:size]
    if size == 12:
        assert header_stamp(data) == 7_000_000_008
    else:
        with pytest.raises(MessageError, match=f"{size} bytes, expected"):
            header_stamp(data)


def encoded(codec, stamp):
    """Return a message of a codec with numbers that are all different."""
    if isinstance(codec, WrenchCodec):
        return codec.encode((1.0, 2.0, 3.0), stamp)
    if isinstance(codec, ContactsCodec):
        return codec.encode(np.arange(9.0).reshape(3, 3), unit_quaternions(3), stamp)
    count = 1 if codec is CODECS["command"] else 2 if codec is CODECS["slip"] else 3
    return codec.encode(stamp, *(np.arange(2.0) + 10.0 * n for n in range(count)))


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
def test_bytes_of_our_own_are_read_without_ros_and_others_with_it(codec, monkeypatch):
    """That is what makes them fast."""
    read, through_ros = wire.read_message, []
    monkeypatch.setattr(wire, "read_message", lambda *a: through_ros.append(1) or read(*a))
    data = encoded(codec, 3_000_000_005)
    stamp, ours = codec.decode(data)
    assert stamp == 3_000_000_005 and through_ros == []
    stamp, theirs = codec.decode(data + bytes(4))  # which ROS allows
    assert stamp == 3_000_000_005 and through_ros == [1]
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)


ARM = ["arm_1", "a", "arm_2", "b"]


def test_joint_states_of_an_arm_and_a_hand_are_read_by_the_names_of_the_hand():
    """One driver may publish all joints of a robot; what the arm's are does not matter."""
    codec = JointCodec(["b", "a"], wanted=("position", "velocity"), others=True)
    message = JointState(
        name=ARM,
        position=[math.nan, 1.0, 9.0, 2.0],
        velocity=[0.0, 3.0, 0.0, 4.0],
        effort=[0.0] * 4,
    )
    for _ in range(2):
        _, (position, velocity), effort = codec.decode_with_last(serialize_message(message))
        assert (position.tolist(), velocity.tolist()) == ([2.0, 1.0], [4.0, 3.0])
        assert effort.tolist() == [0.0, 0.0]
    with pytest.raises(MessageError, match="unknown joint 'arm_1'"):
        JointCodec(["b", "a"], ("effort",)).decode(serialize_message(message))
    message.name[0] = "a"
    with pytest.raises(MessageError, match="joint 'a' is there 2 times"):
        codec.decode(serialize_message(message))
