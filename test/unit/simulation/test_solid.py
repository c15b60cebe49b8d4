# SPDX-License-Identifier: Apache-2.0
"""The object's shape: faces, edges, corners, degenerate input, and random polyhedra."""

import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support.exact import nearest_point
from support.grasps import normals

from tactile_hand_ros.errors import ConfigurationError, ObjectModelError
from tactile_hand_ros.simulation.plant_config import ObjectConfig
from tactile_hand_ros.simulation.solid import Solid, closest_point

BOX = Solid.box(np.array([0.2, 0.4, 0.6]))
GOLDEN = (1.0 + 5.0**0.5) / 2.0


def dodecahedron(decimals=None):
    """Return a dodecahedron with corners rounded to a few decimals, as from a user."""
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for a in (-1, 1):
        for b in (-1, 1):
            corners += [[0, a / GOLDEN, b * GOLDEN], [a / GOLDEN, b * GOLDEN, 0]]
            corners += [[a * GOLDEN, 0, b / GOLDEN]]
    points = 0.06 * np.array(corners)
    return points if decimals is None else points.round(decimals)


def test_a_box_is_the_hull_of_its_corners():
    """Its planes are explicit, since computing them would load a library."""
    hull = Solid(BOX.vertices)
    for ours, found in zip(BOX.shape, hull.shape, strict=True):
        np.testing.assert_allclose(ours, found, atol=1e-15)


def test_corners_of_a_face_run_counter_clockwise_about_its_normal():
    for solid in (BOX, Solid(dodecahedron())):
        for normal, offset, corners in zip(
            solid.normals, solid.offsets, solid.face_corners, strict=True
        ):
            at = solid.vertices[corners]
            np.testing.assert_allclose(at @ normal, offset, atol=1e-12)
            sides = np.roll(at, -1, axis=0) - at
            assert (np.cross(sides, np.roll(sides, -1, axis=0)) @ normal > 0.0).all()


def test_a_dodecahedron_has_pentagons():
    solid = Solid(dodecahedron())
    assert [len(corners) for corners in solid.face_corners] == [5] * 12
    assert len(solid.edges) == 30
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1.0)


@pytest.mark.parametrize("decimals", [None, 8, 7, 6, 5, 4, 3])
def test_corners_typed_with_few_decimals_leave_no_holes(decimals):
    """Rounding bends the faces slightly; every point above one must still find it."""
    corners = dodecahedron(decimals)
    solid, hull = Solid(corners), ConvexHull(corners)
    random = np.random.default_rng(1)
    for triangle, plane in zip(corners[hull.simplices], hull.equations, strict=True):
        for _ in range(10):
            point = random.dirichlet([1.0, 1.0, 1.0]) @ triangle + 0.05 * plane[:3]
            distance, normal = closest_point(solid.shape, point)
            assert distance == pytest.approx(0.05, abs=1e-7)
            np.testing.assert_allclose(normal, plane[:3], atol=1e-4)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((8, 3)),
        np.eye(3),
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 0]]),
    ],
)
def test_what_spans_no_solid_is_refused(points):
    with pytest.raises(ObjectModelError, match="do not span a solid"):
        Solid(points)


def test_many_corners_take_no_minutes():
    """Comparing the planes pair by pair would take minutes for 3000 corners."""
    points = np.random.default_rng(1).normal(size=(1000, 3))
    start = time.process_time()
    solid = Solid(points / np.linalg.norm(points, axis=1)[:, None])
    assert time.process_time() - start < 3.0
    assert len(solid.normals) == 1996


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size": (0.1, 0.0, 0.1)}, "all three edges must be positive"),
        ({"inertia": (1.0, -1.0, 1.0)}, "expected three positive values"),
        ({"inertia": (1.0, 3.1, 2.0)}, "a principal inertia above the sum.*lower 3.1 to 3 or less"),
        ({"vertices": [1.0, 2.0]}, "expected x, y, z of every corner"),
        ({"vertices": [0.1] * 1503}, "should have at most 1500 items"),
        ({"shape": "sphere", "size": (0.1, 0.1, 0.2)}, r"a sphere has \[d, d, d\]"),
        ({"shape": "cylinder", "size": (0.1, 0.2, 0.2)}, r"a cylinder has \[d, d, length\]"),
        ({"shape": "capsule", "size": (0.2, 0.2, 0.1)}, r"a capsule has \[d, d, length with the"),
        ({"shape": "sphere", "mesh": "mug.stl"}, "expected only one of a round shape, vertices"),
        ({"mesh": "mug.stl", "vertices": [0.0] * 12}, "shape = box, 4 vertices and mesh = 'mug"),
        ({"mass": 0.0}, "mass is 0.0"),
        ({"friction": -1.0}, "friction is -1.0"),
    ],
)
def test_what_is_no_body_is_refused(values, message):
    with pytest.raises(ConfigurationError, match=message):
        ObjectConfig().changed(values)


def test_a_body_without_given_inertia_is_uniform():
    x, y, z = size = 0.1, 0.2, 0.3
    box = ObjectConfig(size=size, mass=1.2)
    expected = 0.1 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(box.inertia_about(box.solid()), expected, rtol=1e-12)
    given = ObjectConfig(size=size, mass=1.2, inertia=[0.01, 0.02, 0.015])
    np.testing.assert_array_equal(given.inertia_about(given.solid()), np.diag(given.inertia))


def test_the_inertia_of_a_turned_body_is_turned():
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    box = Solid.box(np.array([0.1, 0.2, 0.3]))
    turned = Solid(box.vertices @ turn.T)
    np.testing.assert_allclose(turned.gyration(), turn @ box.gyration() @ turn.T, atol=1e-12)


def test_a_uniform_body_off_its_center_is_refused():
    corners = (Solid.box(np.full(3, 0.1)).vertices + [0.0, 0.02, 0.0]).ravel().tolist()
    body = ObjectConfig(vertices=corners)
    with pytest.raises(ObjectModelError, match=r"at \(.*, 0.02, .*move the vertices, or give"):
        body.inertia_about(body.solid())
    body = ObjectConfig(vertices=corners, inertia=[1e-6] * 3)
    assert body.inertia_about(body.solid())[0, 0] == 1e-6


random_numbers = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@settings(max_examples=60)
@given(random_numbers, st.integers(4, 30), normals, st.floats(0.0, 1.0))
def test_distance_and_normal_of_random_polyhedra(random, corners, direction, how_far):
    """Outside, they refer to the nearest point; inside, to the nearest face."""
    solid = Solid(random.uniform(-0.1, 0.1, (corners, 3)))
    inside = random.dirichlet(np.ones(len(solid.vertices))) @ solid.vertices
    point = inside + how_far * direction
    distance, normal = closest_point(solid.shape, point)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    heights = solid.normals @ point - solid.offsets
    if (heights < 0.0).all():
        assert distance == heights.max()
        np.testing.assert_array_equal(normal, solid.normals[heights.argmax()])
        return
    expected = nearest_point(solid.vertices, point)
    assert distance == pytest.approx(np.linalg.norm(point - expected), abs=1e-9)
    np.testing.assert_allclose(point - distance * normal, expected, atol=1e-6)


ROUND = [("cylinder", 0.06, 0.1), ("cylinder", 0.1, 0.03), ("sphere", 0.08, 0.08)]
ROUND += [("capsule", 0.05, 0.12), ("capsule", 0.05, 0.05)]


def is_inside(kind, diameter, length, points):
    """Return which points, shape (n, 3), are inside a round body, by its definition."""
    radius, height = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
    if kind == "cylinder":
        return (radius <= 0.5 * diameter) & (height <= 0.5 * length)
    return np.hypot(radius, np.maximum(0.0, height - 0.5 * (length - diameter))) <= 0.5 * diameter


def filled(body, count, seed=2):
    """Return random points inside a round body, shape (n, 3)."""
    points = np.random.default_rng(seed).random((count, 3)) - 0.5
    points *= [body[1], body[1], body[2]]
    return points[is_inside(*body, points)]


@pytest.mark.parametrize("body", ROUND)
def test_the_closest_point_of_a_round_body_is_on_its_surface_and_no_other_is_closer(body):
    shape, within = Solid.revolved(*body).shape, filled(body, 20_000)
    random, half = np.random.default_rng(1), 0.5 * body[2]
    on_axis = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.01 * half], [0.0, 0.0, -3.0 * half]]
    around = random.standard_normal((20_000, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    for point in np.vstack([on_axis, 0.08 * random.standard_normal((100, 3))]):
        distance, normal = closest_point(shape, point)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        closest = point - distance * normal
        around_it = np.outer([1.0 - 1e-9, 1.0 + 1e-9], closest)
        assert is_inside(*body, around_it).tolist() == [True, False]
        assert (distance < 0.0) == is_inside(*body, point[None])[0]
        if distance > 0.0:  # the body is behind the plane through its closest point
            assert ((within - closest) @ normal).max() < 1e-12
        else:  # the ball around the point is in the body
            assert is_inside(*body, point + (-distance - 1e-9) * around).all()


@pytest.mark.parametrize("body", ROUND)
def test_round_bodies_are_uniform_and_drawn_within_a_hundredth(body):
    """Against random points inside, and the polyhedron that is drawn."""
    kind, diameter, length = body
    size, points = (diameter, diameter, length), filled(body, 1_000_000)
    moment = points.T @ points / len(points)
    config = ObjectConfig(shape=kind, size=size, mass=2.0)
    solid = config.solid()
    expected = 2.0 * (np.trace(moment) * np.eye(3) - moment)
    np.testing.assert_allclose(config.inertia_about(solid), expected, atol=6e-3 * expected.max())
    drawn = Solid(solid.vertices).gyration()
    np.testing.assert_allclose(drawn, solid.gyration(), atol=0.015 * drawn.max())
    np.testing.assert_allclose(2.0 * solid.vertices.max(axis=0), size, rtol=0.01)
    # The lines that are drawn are edges of the surface: both ends and the middle are on it.
    for line in solid.vertices[solid.edges]:
        for point in (*line, line.mean(axis=0)):
            assert abs(closest_point(solid.shape, point)[0]) < 0.005 * diameter


def mesh_file(tmp_path, mesh, name="body.stl"):
    mesh.export(tmp_path / name)
    return str(tmp_path / name)


def test_the_mesh_of_a_box_is_the_box_wherever_its_origin_and_unit(tmp_path):
    mesh = trimesh.creation.box((100.0, 200.0, 300.0))
    mesh.apply_translation([70.0, -30.0, 20.0])
    body = ObjectConfig(mesh=mesh_file(tmp_path, mesh), scale=0.001, mass=1.2)
    box = ObjectConfig(size=(0.1, 0.2, 0.3), mass=1.2)
    ours, expected = body.solid(), box.solid()
    assert ours.excess == pytest.approx(0.0, abs=1e-6)
    inertia = box.inertia_about(expected)
    np.testing.assert_allclose(body.inertia_about(ours), inertia, atol=1e-6 * inertia.max())
    for point in 0.2 * np.random.default_rng(3).standard_normal((50, 3)):
        distance, normal = closest_point(expected.shape, point)
        found, direction = closest_point(ours.shape, point)
        assert found == pytest.approx(distance, abs=1e-7)
        np.testing.assert_allclose(direction, normal, atol=1e-5)


def test_the_mass_is_that_of_the_mesh_and_many_corners_are_simplified(tmp_path):
    """A block with a quarter cut out has its center of mass off the middle of its hull."""
    polygon = [[0, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1], [0.1, 0.2], [0, 0.2]]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    block = trimesh.creation.extrude_triangulation(np.array(polygon), np.array(faces), 0.1)
    solid = ObjectConfig(mesh=mesh_file(tmp_path, block)).solid()
    assert solid.excess == pytest.approx(3.5 / 3.0 - 1.0, abs=1e-6)
    # Three cubes of 0.1 m: one at the corner, one along x, one along y.
    low = [-0.25 / 3, -0.25 / 3, -0.05]
    np.testing.assert_allclose(solid.vertices.min(axis=0), low, atol=1e-7)
    centers = np.array([[0, 0], [0.1, 0], [0, 0.1]]) - 0.1 / 3
    expected = 0.01 / 12 * 2 + (centers**2).sum(axis=1).mean()
    assert solid.gyration()[2, 2] == pytest.approx(expected, rel=1e-5)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    solid = ObjectConfig(mesh=mesh_file(tmp_path, ball)).solid()
    assert 300 < len(solid.vertices) <= 500 and -0.03 < solid.excess < 0.0
    assert solid.gyration()[0, 0] == pytest.approx(0.4 * 0.05**2, rel=0.01)


def test_what_is_no_mesh_is_refused(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.update_faces(np.arange(12) > 0)
    (tmp_path / "text.stl").write_text("no mesh")
    for file, message in (
        (mesh_file(tmp_path, box), "surface of 11 triangles is not closed"),
        (str(tmp_path / "text.stl"), "text.stl: its surface of 0 triangles"),
        (str(tmp_path / "none.stl"), "none.stl: cannot be read as a mesh"),
    ):
        with pytest.raises(ObjectModelError, match=message):
            ObjectConfig(mesh=file).solid()
