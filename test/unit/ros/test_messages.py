# SPDX-License-Identifier: Apache-2.0
"""Our bytes equal those of ROS; foreign bytes are read as by ROS, or rejected."""

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
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64
from support.messages import (
    contacts_message,
    force_message,
    joint_message,
    pose_message,
    stamp_to_ns,
)

from tactile_hand_ros.cdr import LARGEST_MESSAGE, clock_bytes, header_stamp
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.errors import MessageError, UnsafeOutputError
from tactile_hand_ros.ros.messages import (
    ContactsCodec,
    ImuCodec,
    JointCodec,
    PoseCodec,
    WrenchCodec,
    read_number,
)
from tactile_hand_ros.rotations import rotation_from_quaternion

FIELDS = ("position", "velocity", "effort")
LARGEST = 1e9
BEYOND = math.nextafter(LARGEST, math.inf)
stamps = st.integers(0, 2**31 * 10**9 - 1)
names = st.lists(st.text("abc_1é", min_size=1, max_size=9), min_size=1, max_size=9, unique=True)


def vectors(size):
    return arrays(np.float64, size, elements=st.floats(-LARGEST, LARGEST))


def unit_quaternions(count):
    turns = np.random.default_rng(count).normal(size=(count, 4))
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


def same_bits(ours, theirs):
    """Compare bit by bit, so that -0.0 is not 0.0."""
    assert np.asarray(ours, dtype=float).tobytes() == np.asarray(theirs, dtype=float).tobytes()


@given(stamps, vectors(3), st.text("abc_1é", max_size=20))
def test_a_force_is_read_by_ros_and_by_us(stamp, force, frame):
    codec = WrenchCodec(frame)
    data = codec.encode(force, stamp)
    message = deserialize_message(data, WrenchStamped)
    assert stamp_to_ns(message.header.stamp) == stamp and message.header.frame_id == frame
    vector = message.wrench.force
    same_bits([vector.x, vector.y, vector.z], force)
    theirs = force_message(force, stamp, frame)
    for received in (data, serialize_message(theirs), data + bytes(4)):
        found, ours = codec.decode(received)
        assert found == stamp
        same_bits(ours, force)


def test_a_normal_force_may_come_alone_but_only_from_a_skin():
    known, nan = (math.nan, 3.0, math.nan), math.nan
    skin, strict = WrenchCodec("tip", normal_allowed=True), WrenchCodec("tip")
    data = skin.encode(known, 7)
    same_bits(skin.decode(data)[1], known)
    with pytest.raises(MessageError, match="expected three finite numbers"):
        strict.decode(data)
    for wrong in ((nan, 3.0, 1.0), (nan, nan, nan), (nan, BEYOND, nan), (1.0, nan, 1.0)):
        with pytest.raises(UnsafeOutputError):
            skin.encode(wrong, 7)
        with pytest.raises(MessageError, match="expected three finite numbers") as refused:
            skin.decode(serialize_message(force_message(wrong, 7, "tip")))
        assert BEYOND in wrong or f"force is {wrong}" in str(refused.value)


@given(stamps, st.integers(1, 6), st.data())
def test_contacts_are_read_by_ros_and_by_us(stamp, count, data):
    positions = data.draw(vectors((count, 3)))
    quaternions = unit_quaternions(count)
    open_ = data.draw(st.lists(st.booleans(), min_size=count, max_size=count))
    positions[open_], quaternions[open_] = np.nan, np.nan
    codec = ContactsCodec(count)
    ours = codec.encode(positions, quaternions, stamp)
    message = contacts_message(positions, quaternions, stamp)
    assert str(deserialize_message(ours, PoseArray)) == str(message)
    for received in (ours, serialize_message(message), ours + bytes(4)):
        stamp_read, found = codec.decode(received)
        assert stamp_read == stamp
        np.testing.assert_array_equal(found.position, positions)
        np.testing.assert_array_equal(found.quaternion, quaternions)


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
    for received in (ours, theirs, ours + bytes(4)):
        found, arrays_read = codec.decode(received)
        assert found == stamp
        for read, value in zip(arrays_read, values, strict=True):
            same_bits(read, value)


@given(stamps)
def test_an_imu_is_read_by_ros_and_by_us_and_knows_only_its_orientation(stamp):
    (quaternion,) = unit_quaternions(1)
    data = ImuCodec().encode(quaternion, stamp)
    theirs = deserialize_message(data, Imu)
    o = theirs.orientation
    assert theirs.header.frame_id == "palm" and [o.x, o.y, o.z, o.w] == quaternion.tolist()
    assert theirs.angular_velocity_covariance[0] == theirs.linear_acceleration_covariance[0] == -1.0
    assert not theirs.orientation_covariance.any() and theirs.linear_acceleration.x == 0.0
    for received in (data, serialize_message(theirs)):
        found, orientation = ImuCodec().decode(received)
        assert found == stamp and orientation.tolist() == quaternion.tolist()
    with pytest.raises(MessageError, match="orientation"):
        ImuCodec().decode(ImuCodec().encode(2.0 * quaternion, stamp))


def test_an_imu_that_declares_no_orientation_is_refused():
    message = Imu()  # at rest, of unknown covariance
    stamp, orientation = ImuCodec().decode(serialize_message(message))
    assert stamp == 0 and orientation.tolist() == [0.0, 0.0, 0.0, 1.0]
    message.orientation_covariance[0] = -1.0
    with pytest.raises(MessageError, match=r"orientation_covariance\[0\] is -1"):
        ImuCodec().decode(serialize_message(message))


@given(stamps, vectors(3))
def test_pose_and_clock_are_read_by_ros_and_by_us(stamp, position):
    (quaternion,) = unit_quaternions(1)
    data = PoseCodec().encode(position, quaternion, stamp)
    theirs = pose_message(position, quaternion, stamp)
    assert deserialize_message(data, PoseStamped) == theirs
    for received in (data, serialize_message(theirs)):
        found, pose = PoseCodec().decode(received)
        assert found == stamp
        same_bits([*pose.position, *pose.quaternion], [*position, *quaternion])
    clock = deserialize_message(clock_bytes(stamp), Clock)
    assert stamp_to_ns(clock.clock) == stamp


@pytest.mark.parametrize(("square", "taken"), [(0.9989, 0), (0.9991, 1), (1.0009, 1), (1.0011, 0)])
def test_a_quaternion_of_nearly_unit_length_is_a_rotation_and_others_are_refused(square, taken):
    """In a pose and in contacts, whether too long or too short."""
    positions, turns = np.arange(9.0).reshape(3, 3), unit_quaternions(3)
    rotation = rotation_from_quaternion(turns[1])
    turns[1] *= np.sqrt(square)
    pose = PoseCodec().encode(positions[1], turns[1], 1)
    contacts = ContactsCodec(3).encode(positions, turns, 1)
    if not taken:
        for codec, data in ((PoseCodec(), pose), (ContactsCodec(3), contacts)):
            with pytest.raises(MessageError, match="expected a unit quaternion"):
                codec.decode(data)
        return
    # It must not stretch the following values.
    _, (_, quaternion) = PoseCodec().decode(pose)
    np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, atol=1e-15)
    found = Contacts.from_poses(*ContactsCodec(3).decode(contacts)[1])
    np.testing.assert_allclose(found.rotations[1], rotation, atol=1e-15)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (JointState(name=["aa", "bx"], effort=[1.0, 2.0]), "unknown joint 'bx'. Valid are: aa, bb"),
        (JointState(name=["aa"], effort=[1.0]), "joint 'bb' is missing"),
        (JointState(name=["aa", "bb", "aa"], effort=[1.0] * 3), "'aa' appears 2 times, expected e"),
        (JointState(name=["aa", "bb"], effort=[1.0]), "effort has 1 values, expected 2"),
        (JointState(name=["aa", "bb"], effort=[1.0, math.nan]), "effort of joint 'bb' is nan"),
        (JointState(name=["bb", "aa"], effort=[1.0, -BEYOND]), "effort of joint 'aa' is -1"),
        (JointState(name=["aa", "bb"]), "effort has 0 values"),
        (JointState(effort=[1.0, 2.0]), "joint 'aa' is missing"),
    ],
)
def test_a_wrong_command_is_refused_in_words_and_the_next_is_read(message, words):
    codec = JointCodec(["aa", "bb"], ("effort",))
    with pytest.raises(MessageError, match=words):
        codec.decode(serialize_message(message))
    good = JointState(name=["bb", "aa"], effort=[1.0, 2.0])
    assert codec.decode(serialize_message(good))[1][0].tolist() == [2.0, 1.0]


def contacts_with(change):
    message = contacts_message(np.zeros((3, 3)), unit_quaternions(3), 1)
    change(message)
    return ContactsCodec(3), message


def pose_with(change):
    message = pose_message((1.0, 2.0, 3.0), np.eye(3), 1)
    change(message)
    return PoseCodec(), message


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (contacts_with(lambda m: m.poses.pop()), "2 contacts, expected 3"),
        (contacts_with(lambda m: m.poses.clear()), "0 contacts, expected 3"),
        (contacts_with(lambda m: setattr(m.header, "frame_id", "world")), "'world', expected 'p"),
        (contacts_with(lambda m: setattr(m.poses[1].position, "x", np.nan)), r"contact 1 is at"),
        (contacts_with(lambda m: setattr(m.poses[1].position, "z", np.inf)), r"or all NaN"),
        (contacts_with(lambda m: setattr(m.poses[0].position, "y", BEYOND)), r"contact 0 is at"),
        (contacts_with(lambda m: setattr(m.poses[2].orientation, "w", 9.0)), "2 has the quat"),
        (contacts_with(lambda m: setattr(m.poses[2].orientation, "w", np.nan)), "2 has the quat"),
        (pose_with(lambda m: setattr(m.pose.position, "x", -BEYOND)), "position is"),
        (pose_with(lambda m: setattr(m.pose.position, "z", np.nan)), "position is"),
        (pose_with(lambda m: setattr(m.header, "frame_id", "")), "frame_id is '', expected 'palm'"),
        (pose_with(lambda m: setattr(m.pose.orientation, "w", 0.0)), "expected a unit quaternion"),
    ],
)
def test_bad_contacts_and_poses_are_refused(case, words):
    codec, message = case
    with pytest.raises(MessageError, match=words):
        codec.decode(serialize_message(message))


@pytest.mark.parametrize("kept", [slice(0, 3), slice(3, 7), slice(0, 7)])
def test_only_a_desired_pose_may_keep_its_parts_by_nan(kept):
    row = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    row[kept] = np.nan
    codec = PoseCodec(nan_allowed=True)
    data = codec.encode(row[:3], row[3:], 5)
    same_bits(np.concatenate(codec.decode(data)[1]), row)
    with pytest.raises(MessageError):
        PoseCodec().decode(data)
    row[:] = np.nan, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0
    with pytest.raises(MessageError, match="position is"):
        codec.decode(codec.encode(row[:3], row[3:], 5))


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_part_of_a_force_counts_up_to_the_largest_number(place, sign):
    """By itself: the sum of squares of three large ones is above the limit."""
    codec, force = WrenchCodec("tip"), [9e8, -9e8, 9e8]
    force[place] = sign * LARGEST
    stamp, read = codec.decode(codec.encode(force, 5))
    assert (stamp, list(read)) == (5, force)
    for wrong in (sign * BEYOND, sign * 1e150, sign * math.inf, math.nan):
        force[place] = wrong
        with pytest.raises(UnsafeOutputError, match="not finite"):
            codec.encode(force, 5)
        with pytest.raises(MessageError, match=r"force is \(.*expected three finite numbers"):
            codec.decode(serialize_message(force_message(force, 5, "tip")))


@pytest.mark.parametrize("place", range(3))
def test_any_part_that_is_nan_makes_the_answer_nan_in_the_right_frame(place):
    force = [1.0, 2.0, 3.0]
    force[place] = math.nan
    data = serialize_message(force_message(force, 5, "tip"))
    for codec in (
        WrenchCodec("tip", nan_allowed=True),
        WrenchCodec("other", nan_allowed=True, any_frame=True),
    ):
        stamp, read = codec.decode(data)
        assert stamp == 5 and len(read) == 3 and np.isnan(read).all()
    with pytest.raises(MessageError, match="frame_id is 'tip', expected 'other'"):
        WrenchCodec("other", nan_allowed=True).decode(data)
    codec = WrenchCodec("tip", nan_allowed=True)
    with pytest.raises(MessageError):  # infinity is no answer
        codec.decode(serialize_message(force_message((math.inf, 0.0, 0.0), 5, "tip")))
    with pytest.raises(UnsafeOutputError):
        codec.encode((math.nan, math.inf, 0.0), 5)


@pytest.mark.parametrize("place", range(7))
def test_each_number_is_checked_before_it_is_sent(place):
    row = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8])
    row[place] = math.nan
    with pytest.raises(UnsafeOutputError):
        PoseCodec().encode(row[:3], row[3:], 5)
    row[place] = math.inf
    with pytest.raises(UnsafeOutputError):
        ContactsCodec(1).encode(row[None, :3], row[None, 3:], 5)
    blocks = [np.zeros(2), np.zeros(2)]
    blocks[place % 2][1] = BEYOND
    with pytest.raises(UnsafeOutputError, match="was not published"):
        JointCodec(["a", "b"], ("position", "velocity")).encode(0, *blocks)


def test_a_number_is_read_unless_it_is_of_another_encoding_or_not_finite():
    data = serialize_message(Float64(data=2.5))
    assert read_number(data) == 2.5
    with pytest.raises(MessageError, match="12 bytes that are not a std_msgs/msg/Float64"):
        read_number(bytes(4) + data[4:])
    for wrong in (math.nan, math.inf, -BEYOND):
        with pytest.raises(MessageError, match=f"data is {wrong}"):
            read_number(serialize_message(Float64(data=wrong)))


@pytest.mark.parametrize(
    ("seconds", "nanoseconds"), [(2**31 - 1, 2**32 - 1), (0, 10**9), (-1, 0), (-(2**31), 10**9 - 1)]
)
def test_a_stamp_that_is_no_time_is_refused(seconds, nanoseconds):
    data = bytearray(WrenchCodec("tip").encode((0.0, 1.0, 0.0), 0))
    struct.pack_into("<iI", data, 4, seconds, nanoseconds)
    for received in (bytes(data), bytes(data) + bytes(4)):
        with pytest.raises(MessageError, match="the stamp is"):
            WrenchCodec("tip").decode(received)


@pytest.mark.parametrize("size", range(13))
def test_a_stamp_needs_twelve_bytes(size):
    data = clock_bytes(7_000_000_008)[:size]
    if size == 12:
        assert header_stamp(data) == 7_000_000_008
    else:
        with pytest.raises(MessageError, match=f"{size} bytes, expected"):
            header_stamp(data)


def test_no_sender_makes_an_error_long():
    long = "x" * 10_000
    joints, force = JointState(name=[long], effort=[1.0]), force_message((0, 0, 0), 0, long)
    with pytest.raises(MessageError, match=r"'x{77}\.\.\.'") as unknown:
        JointCodec(["a", "b"], ("effort",)).decode(serialize_message(joints))
    with pytest.raises(MessageError, match=r"'x{77}\.\.\.'") as frame:
        WrenchCodec("tip").decode(serialize_message(force))
    assert max(len(str(unknown.value)), len(str(frame.value))) < 300


def test_a_message_may_have_the_largest_size_and_not_a_byte_more():
    data = WrenchCodec("tip").encode((1.0, 2.0, 3.0), 5).ljust(LARGEST_MESSAGE, b"\0")
    assert WrenchCodec("tip").decode(data) == (5, (1.0, 2.0, 3.0))
    with pytest.raises(MessageError, match=f"{LARGEST_MESSAGE + 1} bytes, expected at most"):
        WrenchCodec("tip").decode(data + b"\0")


def test_joint_states_of_an_arm_and_a_hand_are_read_by_the_names_of_the_hand():
    """One driver may publish all joints of a robot; those of the arm are ignored."""
    codec = JointCodec(["b", "a"], others=True)
    message = JointState(
        name=["arm_1", "a", "arm_2", "b"],
        position=[math.nan, 1.0, 9.0, 2.0],
        velocity=[0.0, 3.0, 0.0, 4.0],
        effort=[0.0] * 4,
    )
    for _ in range(2):
        _, (position, velocity, effort) = codec.decode_joints(serialize_message(message))
        assert (position.tolist(), velocity.tolist()) == ([2.0, 1.0], [4.0, 3.0])
        assert effort.tolist() == [0.0, 0.0]
    with pytest.raises(MessageError, match="unknown joint 'arm_1'"):
        JointCodec(["b", "a"], ("effort",)).decode(serialize_message(message))
    message.name[0] = "a"
    with pytest.raises(MessageError, match="joint 'a' appears 2 times"):
        codec.decode(serialize_message(message))
    message.name[0], message.name[1] = "arm_1", "finger_a1"
    with pytest.raises(MessageError, match="'finger_a_1' is missing.* did you mean 'finger_a1'"):
        JointCodec(["b", "finger_a_1"], others=True).decode(serialize_message(message))
