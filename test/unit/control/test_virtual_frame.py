# SPDX-License-Identifier: Apache-2.0
"""The virtual frame: the paper's definition, rigid motions, and more than three contacts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.grasps import point_sets, rotations, three_faces, vectors

from tactile_hand_ros.control.grasp import (
    VirtualFrame,
    best_rotation,
    collinearity_margin,
)
from tactile_hand_ros.errors import CollinearContactsError
from tactile_hand_ros.rotations import rotation_from_vector


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


@settings(max_examples=50)
@given(point_sets(minimum=4, margin=0.3), rotations, st.integers(0, 2**32 - 1))
def test_more_contacts_give_the_best_fitting_rotation(points, rotation, seed):
    """No rotation nearby fits the moved and disturbed contacts better."""
    random = np.random.default_rng(seed)
    frame = VirtualFrame()
    start = frame.orientation(points)
    moved = points @ rotation.T + 0.003 * random.standard_normal(points.shape)
    best = frame.orientation(moved) @ start.T
    before, after = points - points.mean(axis=0), moved - moved.mean(axis=0)

    def misfit(turn):
        return np.sum((after - before @ turn.T) ** 2)

    for axis in np.eye(3):
        for angle in (1e-3, -1e-3):
            assert misfit(rotation_from_vector(angle * axis) @ best) > misfit(best)
    assert np.linalg.det(best) == pytest.approx(1.0)


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
def test_the_best_rotation_is_that_of_scipy_for_turned_and_for_mirrored_points(seed):
    random = np.random.default_rng(seed)
    before = random.standard_normal((5, 3))
    before -= before.mean(axis=0)
    turn = Rotation.from_rotvec(random.standard_normal(3)).as_matrix()
    for mirror in (np.eye(3), np.diag([1.0, -1.0, 1.0])):
        after = before @ (turn @ mirror).T
        expected, _ = Rotation.align_vectors(after, before)
        np.testing.assert_allclose(best_rotation(before, after), expected.as_matrix(), atol=1e-9)
