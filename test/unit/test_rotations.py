# SPDX-License-Identifier: Apache-2.0
"""Quaternions and matrices agree with Pinocchio and SciPy, and survive the round trip."""

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tactile_hand_ros.rotations import (
    cross,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)

components = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(components, components, components, components)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


@given(quaternions)
def test_agrees_with_pinocchio_and_scipy(q):
    rotation = rotation_from_quaternion(q)
    np.testing.assert_allclose(rotation, pinocchio.Quaternion(q).matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation, Rotation.from_quat(q).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    back = quaternion_from_rotation(rotation)
    theirs = Rotation.from_matrix(rotation).as_quat()
    assert min(np.abs(back - theirs).max(), np.abs(back + theirs).max()) < 1e-14
    assert back[3] >= 0.0


def test_nan_rows_stay_nan_and_leave_others_alone():
    q = np.array([[0.0, 0.0, 0.0, 1.0], [np.nan] * 4, [0.0, 0.0, 0.0, 0.0]])
    rotation = rotation_from_quaternion(q)
    np.testing.assert_array_equal(rotation[0], np.eye(3))
    assert np.isnan(rotation[1:]).all()
    back = quaternion_from_rotation(rotation)
    np.testing.assert_array_equal(back[0], q[0])
    assert np.isnan(back[1:]).all()


angles = st.tuples(*[st.floats(-6.0, 6.0)] * 3).map(np.array)


@given(angles)
def test_a_rotation_vector_gives_the_rotation_about_it(vector):
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(vector), expected, atol=1e-14)
    np.testing.assert_allclose(rotation_from_vector(-vector), expected.T, atol=1e-14)


@given(angles, angles)
def test_cross_is_the_cross_product(a, b):
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-13)


@given(quaternions)
def test_a_rotation_vector_comes_back_no_longer_than_half_a_turn(q):
    vector = vector_from_rotation(rotation_from_quaternion(q))
    assert np.linalg.norm(vector) <= np.pi + 1e-15
    np.testing.assert_allclose(rotation_from_vector(vector), rotation_from_quaternion(q), atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-13, 3e-12, 1e-8, 1e-3, 1.0, 3.0])
def test_a_rotation_vector_comes_back_at_every_size(size):
    vector = size * np.array([2.0, -1.0, 2.0]) / 3.0
    found = vector_from_rotation(rotation_from_vector(vector))
    np.testing.assert_allclose(found, vector, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("size", [1e-6, 0.5e-4, 0.99e-4, 1.01e-4, 0.1, 2.0])
def test_sine_and_cosine_of_a_rotation_are_exact_each_for_itself(size):
    """About an axis in the plane, each appears alone in an entry."""
    x, y = 0.6 * size, -0.8 * size
    found = rotation_from_vector([x, y, 0.0])
    cosine = -2.0 * np.sin(0.5 * size) ** 2 * 0.48
    rounding = 1e-13 if size < 1e-4 else max(1e-15, 4e-16 / size**2)
    np.testing.assert_allclose(found[[0, 1], [1, 0]], cosine, rtol=rounding)
    np.testing.assert_allclose(found[2, 1], 0.6 * np.sin(size), rtol=1e-15)
    np.testing.assert_allclose(found[[2, 0], [0, 2]], [0.8 * np.sin(size), -0.8 * np.sin(size)],
                               rtol=1e-15)  # fmt: skip


@pytest.mark.parametrize(
    "axis", [*np.eye(3), (3, -4, 12), (0, 3, -4), (4, 0, -3), (1, -2, 2), (2, 6, -9)]
)
def test_of_both_axes_of_a_half_turn_the_first_component_is_positive(axis):
    unit = np.array(axis) / np.linalg.norm(axis)
    rotation = 2.0 * np.outer(unit, unit) - np.eye(3)
    np.testing.assert_allclose(quaternion_from_rotation(rotation), [*unit, 0.0], atol=1e-15)
