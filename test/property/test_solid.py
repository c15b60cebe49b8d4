# SPDX-License-Identifier: Apache-2.0
"""The nearest point of random polyhedra, against a projection that knows corners only."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exact import nearest_point
from support.grasps import normals

from tactile_hand_ros.simulation.solid import ConvexPolyhedron, closest_point

random_numbers = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@settings(max_examples=100)
@given(random_numbers, st.integers(4, 30), normals, st.floats(0.15, 1.0))
def test_distance_and_normal_of_random_polyhedra(random, corners, direction, how_far):
    solid = ConvexPolyhedron(random.uniform(-0.1, 0.1, (corners, 3)))
    inside = solid.vertices.mean(axis=0)
    point = inside + how_far * direction + 0.02 * random.standard_normal(3)
    if (solid.normals @ point < solid.offsets).all():
        return
    expected = nearest_point(solid.vertices, point)
    normal = np.empty(3)
    distance, on_face = closest_point(solid.shape, point, normal)
    assert distance == pytest.approx(np.linalg.norm(point - expected), abs=1e-9)
    np.testing.assert_allclose(point - distance * normal, expected, atol=1e-6)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    if on_face:
        assert np.abs(solid.normals - normal).max(axis=1).min() < 1e-12


@settings(max_examples=100)
@given(random_numbers, normals)
def test_box_against_clipping(random, direction):
    """The nearest point of a box is the point, clipped to it."""
    half = random.uniform(0.02, 0.3, 3)
    point = direction * random.uniform(0.1, 1.0) + half * random.uniform(-1.0, 1.0, 3)
    clipped = np.clip(point, -half, half)
    if (clipped == point).all():
        return
    normal = np.empty(3)
    distance, _ = closest_point(ConvexPolyhedron.box(2.0 * half).shape, point, normal)
    assert distance == pytest.approx(np.linalg.norm(point - clipped), abs=1e-12)
    np.testing.assert_allclose(normal, (point - clipped) / distance, atol=1e-9)


@settings(max_examples=50)
@given(random_numbers, st.integers(4, 30))
def test_inside_the_nearest_face_counts(random, corners):
    solid = ConvexPolyhedron(random.uniform(-0.1, 0.1, (corners, 3)))
    shares = random.dirichlet(np.ones(len(solid.vertices)))
    point = shares @ solid.vertices
    normal = np.empty(3)
    depth, on_face = closest_point(solid.shape, point, normal)
    assert on_face and depth == pytest.approx((solid.normals @ point - solid.offsets).max())


@settings(max_examples=50)
@given(random_numbers, st.integers(4, 20))
def test_every_corner_is_behind_every_face(random, corners):
    solid = ConvexPolyhedron(random.uniform(-0.1, 0.1, (corners, 3)))
    assert (solid.vertices @ solid.normals.T <= solid.offsets + 1e-12).all()
    # Euler: corners - edges + faces = 2.
    assert len(solid.vertices) - len(solid.edges) + len(solid.normals) == 2
