# SPDX-License-Identifier: Apache-2.0
"""Contact frames follow the convention, on both sides of its threshold; example contacts."""

import numpy as np
import pytest
from hypothesis import given
from support import equations
from support.grasps import normals

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import (
    Contacts,
    contact_frame,
    example_touch,
    hand_jacobian,
    joint_torques,
)
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.scenario.scenario import load_scenario


@given(normals)
def test_frame_is_right_handed_with_y_along_the_normal(normal):
    frame = contact_frame(normal)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame[:, 1], normal, atol=1e-15)
    t_x, n, t_z = frame.T
    np.testing.assert_allclose(np.cross(n, t_z), t_x, atol=1e-12)
    if np.hypot(normal[0], normal[1]) > 1.001e-3:
        assert t_z[2] > 0.0
        np.testing.assert_allclose(t_x[2], 0.0, atol=1e-12)  # t_z has all of palm z


@pytest.mark.parametrize("up", [1.0, -1.0])
@pytest.mark.parametrize("bearing", [0.3, 1.8, -2.5])
def test_palm_x_takes_over_where_the_projection_is_shorter_than_a_thousandth(up, bearing):
    """The projection of z on the face is as long as the horizontal part of the normal."""
    level = np.array([np.cos(bearing), np.sin(bearing)])
    for length, expected in ((1.01e-3, [*(-up * level), 0.0]), (0.99e-3, [1.0, 0.0, 0.0])):
        frame = contact_frame(np.array([*(length * level), up * np.sqrt(1.0 - length**2)]))
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(frame[:, 2], expected, atol=2e-3)


def frames(normals):
    return np.array([contact_frame(np.array(n)) for n in normals])


def test_a_contact_without_a_direction_does_not_count():
    quaternions = quaternion_from_rotation(frames([[-1.0, 0, 0], [1.0, 0, 0], [0, -1.0, 0]]))
    quaternions[2] = 0.0
    contacts = Contacts.from_poses(np.eye(3), quaternions)
    np.testing.assert_array_equal(contacts.touching, [True, True, False])


def test_what_travels_on_a_topic_gives_the_same_frames_back():
    rotations = frames([[-1.0, 0, 0], [1.0, 0, 0], [0.0, -0.6, 0.8]])
    contacts = Contacts.from_poses(np.eye(3), quaternion_from_rotation(rotations))
    np.testing.assert_allclose(contacts.rotations, rotations, atol=1e-15)
    np.testing.assert_allclose(contacts.normals[2], [0.0, -0.6, 0.8], atol=1e-15)
    np.testing.assert_allclose(contacts.centroid, np.full(3, 1 / 3))


@pytest.fixture
def touch():
    """Return fingertips of the paper's hand in some posture, and nearby points."""
    hand, random = Hand.load("paper"), np.random.default_rng(5)
    tips = hand.fingertips(random.uniform(0.2, 0.9, hand.joints))
    return tips, tips.positions + random.normal(0.0, 0.01, (3, 3))


def test_hand_jacobian_is_equation_2_turned_into_frames(touch):
    tips, points = touch
    turned = frames([[0.0, 0.6, 0.8], [-1.0, 0.0, 0.0], [0.48, 0.6, -0.64]])
    found = hand_jacobian(tips, points, turned)
    blocks = np.vsplit(equations.hand_jacobian(*tips, points), 3)
    expected = [frame.T @ block for frame, block in zip(turned, blocks, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_joint_torques_are_the_transposed_hand_jacobian_times_the_forces(touch):
    tips, points = touch
    random = np.random.default_rng(6)
    forces, rates = random.normal(size=(3, 3)), random.normal(size=9)
    jacobian = equations.hand_jacobian(*tips, points)
    torques = joint_torques(tips, points, forces)
    np.testing.assert_allclose(torques, jacobian.T @ forces.ravel(), atol=1e-15)
    assert torques @ rates == pytest.approx((jacobian @ rates) @ forces.ravel())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(12))
def test_each_number_of_a_contact_must_be_finite(place, value):
    positions, rotations = np.eye(3), frames(-np.eye(3))
    target = positions[1] if place < 3 else rotations[1].reshape(9)
    target[place if place < 3 else place - 3] = value
    contacts = Contacts(positions, rotations)
    np.testing.assert_array_equal(contacts.touching, [True, False, True])
    assert np.isfinite(contacts.centroid).all() == (place >= 3)
    assert not contacts.all_touching and Contacts(np.eye(3), frames(np.eye(3))).all_touching


@pytest.mark.parametrize("name", ["paper", "pinch", "human_turn"])
def test_contacts_that_are_carried_along_are_where_the_object_has_them_later(name):
    """It turns by milliradians; the rest is of second order."""
    loop = ClosedLoop(load_scenario(name))
    loop.run(150)
    hand, before = loop.plant.hand, loop.state
    loop.run(5)
    touch, later = before.contacts, loop.state.contacts
    moved = loop.state.theta - before.theta
    tips = hand.fingertips(before.theta)
    positions, frames = carried_along(tips, touch.positions, touch.rotations, moved)
    shift = abs(later.positions - touch.positions).max()
    np.testing.assert_allclose(positions, later.positions, atol=3e-3 * shift)
    turn = abs(later.normals - touch.normals).max()
    np.testing.assert_allclose(frames[:, :, 1], later.normals, atol=3e-3 * turn)
    np.testing.assert_allclose(frames.transpose(0, 2, 1) @ frames, [np.eye(3)] * 3, atol=1e-12)


@pytest.mark.parametrize("fingers", [3, 4, 5])
def test_the_example_of_a_touch_is_a_grasp(fingers):
    """A rehearsal takes every block through a tick with it."""
    contacts, forces = example_touch(fingers)
    np.testing.assert_array_equal(forces, [[0.0, 1.0, 0.0]] * fingers)
    assert ForceOptimizer(ForceOptimizerConfig(), fingers).solve(contacts).ok
