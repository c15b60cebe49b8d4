# SPDX-License-Identifier: Apache-2.0
"""Arrays survive the way into messages and back; bad content gives one clear sentence."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from support.messages import contacts_message, force_message, pose_message

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros.messages import conversions as c
from tactile_hand_ros.ros.messages.wire import ContactsCodec
from tactile_hand_ros.rotations import rotation_from_quaternion

NAMES = ["f1_j1", "f1_j2", "f2_j1"]
stamps = st.integers(0, 2**31 * 10**9 - 1)
vectors = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3).map(np.array)


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


def contacts(count=3):
    turns = np.random.default_rng(1).normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return np.arange(3.0 * count).reshape(count, 3), turns


def test_joints_are_brought_into_the_order_of_the_hand():
    message = JointState(name=["f2_j1", "f1_j1", "f1_j2"], effort=[3.0, 1.0, 2.0])
    order = c.JointOrder(NAMES)
    for _ in range(2):
        np.testing.assert_array_equal(order.read(message, "effort"), [1.0, 2.0, 3.0])
    other = JointState(name=["f1_j2", "f1_j1", "f2_j1"], effort=[2.0, 1.0, 3.0])
    np.testing.assert_array_equal(order.read(other, "effort"), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(order.read(message, "effort"), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (JointState(name=["f1_j1", "f1_j2", "f2_jl"]), "unknown joint 'f2_jl', did you mean"),
        (JointState(name=["f1_j1", "f1_j2"]), "joint 'f2_j1' is missing"),
        (
            JointState(name=[*NAMES, "f1_j1"]),
            "joint 'f1_j1' is there 2 times, expected each of 3 once",
        ),
        (JointState(name=NAMES, effort=[1.0, 2.0]), "effort has 2 values, expected 3"),
        (JointState(name=NAMES, effort=[1.0, np.nan, 0.0]), "effort of joint 'f1_j2' is nan"),
        (JointState(name=NAMES, effort=[1.0, 0.0, np.inf]), "effort of joint 'f2_j1' is inf"),
    ],
)
def test_a_bad_joint_message_is_refused(message, words):
    order = c.JointOrder(NAMES)
    with pytest.raises(MessageError, match=words):
        order.read(message, "effort")
    good = JointState(name=NAMES, effort=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(order.read(good, "effort"), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.poses.pop(), "2 contacts, expected 3"),
        (lambda m: setattr(m.header, "frame_id", "world"), "frame_id is 'world', expected 'palm'"),
        (lambda m: setattr(m.poses[1].position, "x", np.nan), r"contact 1 is at \(nan"),
        (lambda m: setattr(m.poses[1].position, "x", np.inf), r"contact 1 is at \(inf"),
        (lambda m: setattr(m.poses[2].orientation, "w", 9.0), "contact 2 has the quaternion"),
        (lambda m: setattr(m.poses[2].orientation, "w", np.nan), "contact 2 has the quaternion"),
    ],
)
def test_bad_contacts_are_refused(change, words):
    message = contacts_message(*contacts(), 1)
    change(message)
    with pytest.raises(MessageError, match=words):
        c.contacts_from_ros(message, 3)


def test_bad_forces_are_refused():
    message = force_message((0.0, np.nan, 0.0), 1, "f1_contact")
    with pytest.raises(MessageError, match=r"force is \(0.0, nan, 0.0\)"):
        c.force_from_ros(message)
    with pytest.raises(MessageError, match="frame_id is 'f1_contact', expected 'f2_contact'"):
        c.force_from_ros(message, frame="f2_contact")


def test_poses_round_trip_as_matrix_and_as_quaternion():
    _, turns = contacts(1)
    rotation = rotation_from_quaternion(turns[0])
    for given_rotation in (rotation, turns[0]):
        message = over_the_wire(pose_message((1.0, 2.0, 3.0), given_rotation, 9))
        pose = c.pose_from_ros(message)
        np.testing.assert_array_equal(pose.position, (1.0, 2.0, 3.0))
        np.testing.assert_allclose(pose.rotation, rotation, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: setattr(m.pose.position, "z", np.nan), "position is"),
        (lambda m: setattr(m.header, "frame_id", ""), "frame_id is '', expected 'palm'"),
        (lambda m: setattr(m.pose.orientation, "w", 0.0), "expected one of length 1"),
    ],
)
def test_bad_poses_are_refused(change, words):
    message = pose_message((1.0, 2.0, 3.0), np.eye(3), 1)
    change(message)
    with pytest.raises(MessageError, match=words):
        c.pose_from_ros(message)


@pytest.mark.parametrize(("square", "taken"), [(0.9989, 0), (0.9991, 1), (1.0009, 1), (1.0011, 0)])
def test_a_quaternion_of_nearly_unit_length_is_a_rotation_and_others_are_refused(square, taken):
    """In a pose, in contacts and in the bytes of contacts alike, longer ones as shorter ones."""
    positions, turns = contacts()
    rotation = rotation_from_quaternion(turns[1])
    turns[1] *= np.sqrt(square)
    pose = pose_message(positions[1], turns[1], 1)
    poses = contacts_message(positions, turns, 1)
    codec = ContactsCodec(3)
    data = codec.encode(positions, turns, 1)
    if not taken:
        for read in (
            lambda: c.pose_from_ros(pose),
            lambda: c.contacts_from_ros(poses, 3),
            lambda: codec.decode(data),
        ):
            with pytest.raises(MessageError, match="expected one of length 1"):
                read()
        return
    # What follows must not be stretched by it.
    np.testing.assert_allclose(c.pose_from_ros(pose).rotation, rotation, atol=1e-15)
    for got in (c.contacts_from_ros(poses, 3), codec.decode(data)[1]):
        np.testing.assert_array_equal(got.quaternions, turns)
        got = Contacts.from_poses(*got)
        np.testing.assert_allclose(got.rotations[1], rotation, atol=1e-15)


def test_plain_numbers():
    assert c.number_from_ros(Float64(data=2.0)) == 2.0
    with pytest.raises(MessageError, match="data is inf"):
        c.number_from_ros(Float64(data=np.inf))


def test_rumble_is_cut_to_its_range():
    message = over_the_wire(c.feedback_to_ros((0.5, 7.0, -1.0)))
    assert [item.intensity for item in message.array] == [0.5, 1.0, 0.0]
    assert [item.id for item in message.array] == [0, 1, 2]
    assert {item.type for item in message.array} == {1}
    assert c.feedback_to_ros((0.1, 0.2, 0.3), out=message) is message


def test_an_empty_contact_array_is_refused():
    message = PoseArray()
    message.header.frame_id = "palm"
    with pytest.raises(MessageError, match="0 contacts, expected 3"):
        c.contacts_from_ros(message, 3)


def test_the_largest_number_is_usable_and_the_next_is_not():
    beyond = np.nextafter(1e9, np.inf)
    for sign in (1.0, -1.0):
        assert c.is_usable(sign * 1e9) and c.all_usable(np.array([sign * 1e9, 0.0]))
        assert not c.is_usable(sign * beyond)
        assert not c.all_usable(np.array([0.0, sign * beyond]))
    assert c.all_usable(np.full(5, -9e8))
    assert not c.is_usable(np.nan)


def test_a_text_is_repeated_up_to_the_length_of_a_line():
    assert c.shown("x" * 80) == "x" * 80
    assert c.shown("x" * 81) == "x" * 80 + "..."


@pytest.mark.parametrize("place", range(3))
def test_each_part_of_a_point_counts(place):
    point, _, turns = [1.0, 2.0, 3.0], *contacts(1)
    for wrong in (np.nan, np.inf, -1.1e9):
        point[place] = wrong
        message = contacts_message(np.array([point]), turns, 1)
        with pytest.raises(MessageError, match=r"contact 0 is at \("):
            c.contacts_from_ros(message, 1)
        with pytest.raises(MessageError, match="position is"):
            c.pose_from_ros(pose_message(point, turns[0], 1))
    two = np.full(3, np.nan)
    two[place] = 1.0
    with pytest.raises(MessageError, match=r"contact 0 is at \("):
        c.contacts_from_ros(contacts_message(two[None], turns, 1), 1)


def test_another_number_of_rumbles_makes_another_message():
    message = c.feedback_to_ros((0.5, 0.6))
    other = c.feedback_to_ros((0.1, 0.2, 0.3), out=message)
    assert other is not message and len(other.array) == 3
    assert [round(item.intensity, 6) for item in other.array] == [0.1, 0.2, 0.3]
