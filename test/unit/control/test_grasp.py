# SPDX-License-Identifier: Apache-2.0
"""Grasp maps, the checks of A5 and A7, and the required friction of a contact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support import equations
from support.grasps import balance_in_frames, grasps, point_sets, vectors

from tactile_hand_ros.control.grasp import (
    check_joints,
    check_spread,
    collinearity_margin,
    grasp_map,
    joint_margin,
    net_wrench,
    required_friction,
    wrench_forces,
)
from tactile_hand_ros.errors import CollinearContactsError, GraspError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector

LINE = np.array([[0.0, 0.0, 0.1], [0.1, 0.1, 0.1], [0.3, 0.3, 0.1]])


@given(grasps(), vectors)
def test_grasp_map_is_forces_in_contact_frames_and_their_moments(contacts, origin):
    """About any origin it is (4), about the centroid (11); each contact has its own frame."""
    expected = equations.grasp_map(contacts.positions, origin)
    found = grasp_map(contacts.positions - origin, contacts.rotations)
    for i, frame in enumerate(contacts.rotations):
        columns = slice(3 * i, 3 * i + 3)
        np.testing.assert_allclose(found[:, columns], expected[:, columns] @ frame, atol=1e-14)


@given(grasps(), hnp.arrays(float, (5, 3), elements=st.floats(-9.0, 9.0)))
def test_net_wrench_is_the_grasp_map_about_the_centroid_times_the_forces(contacts, forces):
    forces = forces[: len(contacts.positions)]
    found = net_wrench(contacts.positions, contacts.rotations, forces)
    np.testing.assert_allclose(found, balance_in_frames(contacts) @ forces.ravel(), atol=1e-12)


@given(point_sets(), vectors, vectors)
def test_wrench_forces_are_the_pseudoinverse(points, force, torque):
    wrench = np.concatenate([force, torque])
    about_centroid = equations.grasp_map(points, points.mean(axis=0))
    forces = wrench_forces(points, wrench).ravel()
    np.testing.assert_allclose(forces, np.linalg.pinv(about_centroid) @ wrench, atol=1e-9)
    np.testing.assert_allclose(about_centroid @ forces, wrench, atol=1e-10)


def test_contacts_on_a_line_are_an_error_that_says_so():
    for check in (check_spread, lambda points: wrench_forces(points, np.ones(6))):
        with pytest.raises(CollinearContactsError, match=r"\(0.1000, 0.1000.*one line \(A7\)"):
            check(LINE)
    assert collinearity_margin(np.ones((3, 3))) == 0.0


def test_joint_margin_of_the_paper_and_of_a_stretched_finger():
    hand = Hand.load("paper")

    def jacobian(theta):
        tips = hand.fingertips(theta)
        return equations.hand_jacobian(*tips, tips.positions)

    good = jacobian(np.tile([1.047, 0.0, 1.571], 3))
    assert joint_margin(good) == pytest.approx(np.linalg.svd(good, compute_uv=False)[-1])
    assert joint_margin(good.reshape(3, 3, 9)) == joint_margin(good)
    check_joints(good)
    stretched = np.tile([1.047, 0.0, 1.571], 3)
    stretched[5] = 0.0
    with pytest.raises(GraspError, match=r"singular \(A5\).*9 x 9"):
        check_joints(jacobian(stretched))


def test_only_directions_that_a_finger_can_move_in_count_for_the_margin():
    assert joint_margin(np.diag(np.arange(2.0, 11.0), 3)[:9]) == 2.0
    two = np.zeros((3, 3, 7))  # two joints, two joints, three joints
    two[0, :, :2], two[1, :, 2:4] = [[3, 0], [0, 2], [0, 0]], [[0, 0], [0, 5], [6, 0]]
    two[2, :, 4:] = np.diag([4.0, 7.0, 8.0])
    assert joint_margin(two) == pytest.approx(2.0)
    check_joints(two)
    two[1, 2, 2] = 0.0  # a joint without a lever
    two[1, 1, 2] = 1.0
    with pytest.raises(GraspError, match="9 x 7"):
        check_joints(two)
    one = np.zeros((2, 3, 1))  # a gripper with one motor
    one[:, 1, 0] = 1.0, -1.0
    assert joint_margin(one) == pytest.approx(np.sqrt(2.0))


def test_required_friction_of_known_forces():
    forces = np.array([[3.0, 10.0, 4.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(required_friction(forces), [0.5, 0.0, 0.0, np.inf])
    assert required_friction(np.array([0.0, -1.0, 0.1])) == np.inf
    weak = np.array([[0.3, 0.5, 0.4], [3e-9, 4e-9, 4e-9]])
    np.testing.assert_allclose(required_friction(weak), [1.0, 1.25])
    assert required_friction(np.zeros((5, 2, 3))).shape == (5, 2)


def thin(margin, extra=()):
    """Return rotated, nearly collinear contacts: height h over three gives a margin h/3^.5.

    Further ones lie on the line, at multiples of the half length.
    """
    along = np.array([-1.0, 1.0, 0.0, *extra])
    # Second moments about the mean: of the places along the line, and of the third one's height.
    k, spread = len(along), ((along - along.mean()) ** 2).sum()
    height = margin * np.sqrt(spread / (1.0 - 1.0 / k))
    points = np.array([along, height * (np.arange(k) == 2), 0.0 * along]).T
    return 0.1 * points @ rotation_from_vector([0.3, -0.9, 0.5]).T + [0.2, -0.1, 0.4]


@pytest.mark.parametrize("extra", [(), (0.0,), (0.5, -0.5)])
def test_a_grasp_a_thousandth_as_thin_as_long_is_the_limit(extra):
    for margin in (0.99e-3, 1.01e-3):
        points = thin(margin, extra)
        assert collinearity_margin(points) == pytest.approx(margin, rel=1e-3)
        for check in (check_spread, lambda points: wrench_forces(points, np.ones(6))):
            if margin < 1e-3:
                with pytest.raises(CollinearContactsError):
                    check(points)
            else:
                check(points)


@given(point_sets(margin=0.0), st.floats(1e-3, 1.0))
def test_collinearity_margin_is_the_ratio_of_two_extents(points, squash):
    points = points * [1.0, squash, squash]
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    assert collinearity_margin(points) == pytest.approx(extents[1] / extents[0], abs=1e-6)


def test_joints_that_move_a_contact_by_a_millimetre_per_radian_are_the_limit():
    rotation = rotation_from_vector([0.3, -0.9, 0.5])
    for least in (0.99e-3, 1.01e-3):
        jacobian = np.kron(np.diag([1.0, 0.5, 2.0]), rotation)
        jacobian[:, 4] *= least / 0.5
        assert joint_margin(jacobian) == pytest.approx(least)
        if least < 1e-3:
            with pytest.raises(GraspError, match="9 x 9"):
                check_joints(jacobian)
        else:
            check_joints(jacobian)
    with pytest.raises(GraspError, match="at least 0.002"):
        check_joints(jacobian, 2e-3)
