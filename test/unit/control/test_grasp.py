# SPDX-License-Identifier: Apache-2.0
"""Grasp maps, the checks of A5 and A7, required friction, and the virtual frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from support import equations
from support.grasps import balance_in_frames, grasps, point_sets, rotations, three_faces, vectors

from tactile_hand_ros.control.grasp import (
    VirtualFrame,
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


@pytest.mark.parametrize("k", [3, 4, 5])
def test_a_grasp_a_thousandth_as_thin_as_long_is_the_limit(k):
    along = np.linspace(-1.0, 1.0, k)
    across = along**2 - np.mean(along**2)
    across *= 1e-3 * np.linalg.norm(along) / np.linalg.norm(across)
    points = np.array([along, across, 0.0 * along]).T
    turn = rotation_from_vector([0.3, -0.9, 0.5])
    for check in (check_spread, lambda points: wrench_forces(points, np.ones(6))):
        check(points * [1.0, 1.02, 1.0] @ turn)
        with pytest.raises(CollinearContactsError):
            check(points * [1.0, 0.98, 1.0] @ turn)


@given(point_sets(margin=0.0), st.floats(1e-3, 1.0))
def test_collinearity_margin_is_the_ratio_of_two_extents(points, squash):
    points = points * [1.0, squash, squash]
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    assert collinearity_margin(points) == pytest.approx(extents[1] / extents[0], abs=1e-6)


def test_joints_that_move_a_contact_by_a_millimetre_per_radian_are_the_limit():
    jacobian = np.kron(np.diag([1.0, 1.01e-3, 2.0]), rotation_from_vector([0.3, -0.9, 0.5]))
    assert joint_margin(jacobian) == pytest.approx(1.01e-3)
    check_joints(jacobian)
    with pytest.raises(GraspError, match=r"singular \(A5\).*9 x 9.*at least 0.001"):
        check_joints(0.98 * jacobian)
    with pytest.raises(GraspError, match="at least 0.002"):
        check_joints(jacobian, 2e-3)


@given(point_sets(maximum=3))
def test_frame_of_three_contacts_is_the_papers(points):
    r_x, r_y, r_z = VirtualFrame().orientation(points).T
    a, b = points[0] - points[1], points[2] - points[1]
    np.testing.assert_allclose(r_x, a / np.linalg.norm(a), atol=1e-9)
    plane = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
    assert abs(r_z @ plane) == pytest.approx(1.0)
    assert r_z[2] >= 0.0
    np.testing.assert_allclose(np.cross(r_z, r_x), r_y, atol=1e-9)


@given(point_sets(), rotations, vectors)
def test_frame_turns_with_the_grasp_even_upside_down(points, rotation, shift):
    """The side of r_z is chosen once: a half turn must turn the frame, not flip it."""
    frame = VirtualFrame()
    start = frame.orientation(points)
    np.testing.assert_allclose(start.T @ start, np.eye(3), atol=1e-9)
    after = frame.orientation(points @ rotation.T + shift)
    np.testing.assert_allclose(after, rotation @ start, atol=1e-7)


def test_fingers_in_a_row_against_a_thumb_are_a_grasp():
    """The first three contacts are collinear, all four are not: A7 holds."""
    points = np.array([[0.1, 0.1, 0], [0.0, 0.1, 0], [-0.1, 0.1, 0], [0.0, -0.1, 0]])
    frame = VirtualFrame()
    start = frame.orientation(points)
    np.testing.assert_allclose(start, np.eye(3), atol=1e-12)
    turn = rotation_from_vector([0.3, -0.2, 0.5])
    np.testing.assert_allclose(frame.orientation(points @ turn.T), turn, atol=1e-12)


def test_points_on_a_line_have_no_frame():
    line = np.outer([0.0, 1.0, 3.0, 4.0], [0.1, 0.2, 0.3])
    for k in (3, 4):
        with pytest.raises(CollinearContactsError):
            VirtualFrame().orientation(line[:k])
    frame = VirtualFrame()
    frame.orientation(np.vstack([three_faces().positions, [[0.0, 0.0, 0.1]]]))
    with pytest.raises(CollinearContactsError):
        frame.orientation(line)


def test_a_plane_that_stands_upright_keeps_the_side_of_its_normal():
    upright = np.array([[0.0, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.1]])
    frame = VirtualFrame().orientation(upright)
    assert frame[2, 2] == 0.0
    np.testing.assert_array_equal(frame[:, 2], [0.0, 1.0, 0.0])


@pytest.mark.parametrize("margin", [0.099, 0.101])
def test_the_first_three_of_more_contacts_lead_where_they_are_clear_of_a_line(margin):
    """A width of a tenth of the length suffices, even if other contacts are better placed."""
    height = 0.1 * margin * np.sqrt(3.0)
    points = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, height, 0.0], [0.05, 0.2, 0.1]])
    assert collinearity_margin(points[:3]) == pytest.approx(margin, rel=0.02)
    leading = points[:3] if margin > 0.1 else points[[0, 1, 3]]
    found = VirtualFrame().orientation(points)
    np.testing.assert_allclose(found, VirtualFrame().orientation(leading), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_more_contacts_turn_by_the_best_rotation_which_is_that_of_scipy(seed):
    random, frame = np.random.default_rng(seed), VirtualFrame()
    before = random.standard_normal((5, 3))
    start, arms = frame.orientation(before), before - before.mean(axis=0)
    turn = Rotation.from_rotvec(random.standard_normal(3)).as_matrix()
    for mirror in (np.eye(3), np.diag([1.0, -1.0, 1.0])):
        after = before @ (turn @ mirror).T + 0.01 * random.standard_normal((5, 3))
        expected, _ = Rotation.align_vectors(after - after.mean(axis=0), arms)
        found = frame.orientation(after) @ start.T
        np.testing.assert_allclose(found, expected.as_matrix(), atol=1e-9)
