# SPDX-License-Identifier: Apache-2.0
"""The object's shape: a convex polyhedron or a round body, and its closest point to a fingertip."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.errors import ObjectModelError
from tactile_hand_ros.extras import optional

MAX_VERTICES = 500
"""Each step searches all faces for each contact."""

_CENTERED = 0.01  # of the largest coordinate: error of the center of rounded vertices
_DRAWN = 36  # corners around the axis of a drawn round body: 10 degrees, which looks round
_LINES = 4  # lines along it, so that a turn about the axis can be seen


class Shape(NamedTuple):
    """A solid as arrays, in its own frame.

    Attributes:
        normals: Outward unit normals of the faces, shape (f, 3).
        offsets: Distances of the face planes from the origin, shape (f,), m.
        edge_normals: Outward normals, in its plane, of the edges of each face, shape (f, e, 3).
        edge_offsets: Their distances from the origin, shape (f, e), m; infinite where padded.
        edge_starts: One end of every edge, shape (g, 3), m.
        edge_vectors: From there to the other end, shape (g, 3), m.
        profile: Of a body that is round about z: a rectangle in distance from the axis and height,
            and the rounding around it: half extents and radius, shape (3,), m. Zero for a
            polyhedron; for a round body the faces above are for drawing only.
    """

    normals: Array
    offsets: Array
    edge_normals: Array
    edge_offsets: Array
    edge_starts: Array
    edge_vectors: Array
    profile: Array


@compiled
def closest_point(shape: Shape, point: Array) -> tuple[float, Array]:
    """Find the closest point of a solid to a point, shape (3,), m, in the frame of the solid.

    Returns:
        Signed distance in m, negative inside, and the outward unit vector from the solid to the
        point, shape (3,).
    """
    if shape.profile.any():
        return _closest_on_round(shape.profile, point)
    heights = shape.normals @ point - shape.offsets
    face = int(np.argmax(heights))
    # The nearest plane has the nearest face only if the face contains the projection.
    if heights[face] <= 0.0 or _above(shape, face, point):
        return heights[face], shape.normals[face]
    for other in range(len(heights)):
        if heights[other] > 0.0 and _above(shape, other, point):
            return heights[other], shape.normals[other]
    return _closest_on_edges(shape, point)


@compiled
def _closest_on_round(profile: Array, point: Array) -> tuple[float, Array]:
    """Find the closest point in the half plane through axis and point."""
    x, y, z = point
    radius = np.hypot(x, y)
    u, v = radius - profile[0], abs(z) - profile[1]  # beyond side and end of the rectangle
    if u <= 0.0 and v <= 0.0:
        distance = max(u, v)
        u, v = (0.0, 1.0) if v > u else (1.0, 0.0)
    else:
        u, v = max(u, 0.0), max(v, 0.0)
        distance = np.hypot(u, v)
        u, v = u / distance, v / distance
    if radius > 0.0:
        x, y = x / radius, y / radius
    else:  # on the axis all directions are equally near
        x, y = 1.0, 0.0
    return distance - profile[2], np.array([u * x, u * y, v if z > 0.0 else -v])


@compiled
def _above(shape: Shape, face: int, point: Array) -> bool:
    for i in range(shape.edge_offsets.shape[1]):
        n = shape.edge_normals[face, i]
        if n[0] * point[0] + n[1] * point[1] + n[2] * point[2] > shape.edge_offsets[face, i]:
            return False
    return True


@compiled
def _closest_on_edges(shape: Shape, point: Array) -> tuple[float, Array]:
    best, nearest = np.inf, point
    for i in range(len(shape.edge_starts)):
        along = shape.edge_vectors[i]
        apart = point - shape.edge_starts[i]
        s = (apart @ along) / (along @ along)
        apart = apart - min(max(s, 0.0), 1.0) * along
        distance = np.sqrt(apart @ apart)
        if distance < best:
            best, nearest = distance, apart
    return best, nearest / best


class Solid:
    """A convex solid in its own frame.

    Attributes:
        vertices: Corners, of a polyhedron with fine facets for a round body, shape (v, 3), m.
        normals: Outward unit normals of the faces, shape (f, 3).
        offsets: Distances of the face planes from the origin, shape (f,), m.
        edges: Pairs of corner indices, of a round body only lines to draw, shape (e, 2).
        face_corners: Corner indices of each face in order around its normal.
        shape: The same as arrays for `closest_point`.
        excess: Volume of a mesh's convex hull per volume of the mesh, minus 1.
    """

    def __init__(
        self, vertices: Array, planes: Array | None = None, gyration: Array | None = None
    ) -> None:
        """Build the convex hull of a set of points.

        Args:
            vertices: Shape (v, 3), m.
            planes: Outward unit normals n and heights d with n . p + d = 0 on each face, shape
                (f, 4), if known; then all points must be corners.
            gyration: See `gyration`, if known, shape (3, 3), m^2.

        Raises:
            ObjectModelError: If the points do not span a volume.
        """
        points = np.asarray(vertices, dtype=float)
        if planes is None:
            points, planes = _hull(points)
        self.vertices = points
        self.normals, self.offsets = planes[:, :3].copy(), -planes[:, 3]
        self.face_corners = [self._corners_of(f) for f in range(len(planes))]
        self.edges = self._edges()
        self.shape = self._shape()
        self.excess = 0.0
        self._gyration = gyration

    @classmethod
    def box(cls, size: Array) -> Solid:
        """Return a box centered at the origin with the given edge lengths, shape (3,), m."""
        half = np.asarray(size, dtype=float) / 2.0
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        # In the order in which Qhull would find them.
        x, y, z = np.eye(3)
        normals = np.array([-z, -y, x, -x, y, z])
        return cls(signs * half, np.column_stack([normals, -np.abs(normals) @ half]))

    @classmethod
    def revolved(cls, kind: str, diameter: float, length: float) -> Solid:
        """Return a body that is round about z and centered at the origin; lengths in m.

        A capsule is a cylinder with hemispheres as ends, and a sphere a capsule as long as wide.
        """
        radius, rounding = 0.5 * diameter, 0.0 if kind == "cylinder" else 0.5 * diameter
        profile = np.array([radius - rounding, 0.5 * length - rounding, rounding])
        bends = np.linspace(0.0, 0.5 * np.pi, 1 + _DRAWN // 4) if rounding else np.zeros(1)
        turns = np.linspace(0.0, 2.0 * np.pi, _DRAWN, endpoint=False)
        across, up = profile[:2, None] + rounding * np.array([np.cos(bends), np.sin(bends)])
        circle = np.array([np.cos(turns), np.sin(turns)]).T
        rings = [np.insert(u * circle, 2, v, axis=1) for u, v in zip(across, up, strict=True)]
        # Rounded, since the corners at a pole are the same.
        corners = np.vstack([*rings, *(ring * [1.0, 1.0, -1.0] for ring in rings)]).round(15)
        solid = cls(np.unique(corners, axis=0), gyration=_round_gyration(radius, profile))
        solid.edges = solid._lines(profile[1])
        solid.shape = solid.shape._replace(profile=profile)
        return solid

    @classmethod
    def of_mesh(cls, file: str, scale: float) -> Solid:
        """Return the convex hull of a mesh, about the center of mass of the mesh, and its gyration.

        Args:
            file: STL, OBJ or another format of trimesh.
            scale: Meters per unit of the file.

        Raises:
            MissingLibraryError: If trimesh is not installed.
            ObjectModelError: If the file cannot be read or its surface is not closed.
        """
        trimesh = optional("trimesh", "A mesh as object")
        try:
            mesh = trimesh.load_mesh(file)
        except Exception as error:  # of the many readers of trimesh
            raise ObjectModelError(f"{file}: cannot be read as a mesh: {error}") from error
        if not mesh.is_volume:
            raise ObjectModelError(
                f"{file}: its surface of {len(mesh.faces)} triangles is not closed or not oriented "
                "outward, so it has no mass; repair it, as with trimesh.repair or Blender"
            )
        hull = mesh.convex_hull
        if len(points := hull.vertices) > MAX_VERTICES:
            farthest = (points @ _directions(MAX_VERTICES)).argmax(axis=0)
            hull = trimesh.convex.convex_hull(points[np.unique(farthest)])
        gyration = mesh.moment_inertia / mesh.volume * scale**2
        solid = cls((hull.vertices - mesh.center_mass) * scale, gyration=gyration)
        solid.excess = hull.volume / mesh.volume - 1.0
        return solid

    def triangles(self) -> Array:
        """Return the corners of triangles that make up the surface, shape (t, 3, 3), m."""
        faces = self.face_corners
        return self.vertices[[(a, *pair) for a, *rest in faces for pair in pairwise(rest)]]

    def gyration(self) -> Array:
        """Return the inertia of the uniform body per mass about the origin, shape (3, 3), m^2.

        A polyhedron is made of tetrahedra from the origin to triangles of its faces, of volume
        v = a . (b x c) / 6 and second moment v (a a^T + b b^T + c c^T + s s^T) / 20, s = a + b + c.

        Raises:
            ObjectModelError: If its center of mass is not at the origin.
        """
        if self._gyration is not None:
            return self._gyration
        volume, center, moment = 0.0, np.zeros(3), np.zeros((3, 3))
        for abc in self.triangles():
            part, s = np.linalg.det(abc) / 6.0, abc.sum(axis=0)
            volume += part
            center += part * s / 4.0
            moment += part * (abc.T @ abc + np.outer(s, s)) / 20.0
        center, moment = center / volume, moment / volume
        if np.abs(center).max() > _CENTERED * np.abs(self.vertices).max():
            x, y, z = center
            raise ObjectModelError(
                f"the uniform body between these vertices has its center of mass at ({x:.3g}, "
                f"{y:.3g}, {z:.3g}) m, expected the origin; move the vertices, or give 'inertia'"
            )
        return np.asarray(np.trace(moment) * np.eye(3) - moment)

    def _corners_of(self, face: int) -> NDArray[np.intp]:
        """Return the corners on a face, counter-clockwise about its outward normal."""
        normal = self.normals[face]
        scale = np.abs(self.vertices).max()
        heights = self.vertices @ normal - self.offsets[face]
        corners = np.flatnonzero(np.abs(heights) < 1e-7 * scale)
        arms = self.vertices[corners] - self.vertices[corners].mean(axis=0)
        u = arms[0] / np.linalg.norm(arms[0])
        angles = np.arctan2(arms @ np.cross(normal, u), arms @ u)
        ordered: NDArray[np.intp] = corners[angles.argsort()]
        return ordered

    def _edges(self) -> NDArray[np.intp]:
        pairs = {
            tuple(sorted((int(a), int(b))))
            for corners in self.face_corners
            for a, b in zip(corners, np.roll(corners, -1), strict=True)
        }
        return np.array(sorted(pairs))

    def _lines(self, height: float) -> NDArray[np.intp]:
        """Return edges that show a round body: circles at heights of its rims, and some lines."""
        x, y, z = self.vertices[self.edges].transpose(2, 0, 1)
        at_rim = (np.abs(np.abs(z) - height) < 1e-12).all(axis=1) & (z[:, 0] == z[:, 1])
        turn = np.arctan2(y, x) * _LINES / (2.0 * np.pi)
        along = ((np.abs(turn - turn.round()) < 1e-9) | (np.hypot(x, y) == 0.0)).all(axis=1)
        return np.asarray(self.edges[at_rim | along])

    def _shape(self) -> Shape:
        longest = max(len(c) for c in self.face_corners)
        normals = np.zeros((len(self.face_corners), longest, 3))
        offsets = np.full((len(self.face_corners), longest), np.inf)
        for f, corners in enumerate(self.face_corners):
            start = self.vertices[corners]
            outward = np.cross(np.roll(start, -1, axis=0) - start, self.normals[f])
            outward /= np.linalg.norm(outward, axis=1)[:, None]
            normals[f, : len(corners)] = outward
            offsets[f, : len(corners)] = np.einsum("ij,ij->i", outward, start)
        starts, ends = self.vertices[self.edges[:, 0]], self.vertices[self.edges[:, 1]]
        edges = starts, ends - starts
        return Shape(self.normals, self.offsets, normals, offsets, *edges, np.zeros(3))


def _round_gyration(radius: float, profile: Array) -> Array:
    """Return the gyration of a cylinder between the halves of a sphere, shape (3, 3), m^2."""
    _, b, r = profile
    cylinder, sphere = 2.0 * b * radius**2, 4.0 / 3.0 * r**3  # volumes / pi
    about_z = cylinder * radius**2 / 2.0 + sphere * 0.4 * r**2
    # The center of mass of a hemisphere is 3/8 r above its base.
    ends = sphere * (0.4 * r**2 + b**2 + 0.75 * r * b)
    across = cylinder * (radius**2 / 4.0 + b**2 / 3.0) + ends
    return np.asarray(np.diag([across, across, about_z]) / (cylinder + sphere))


def _directions(count: int) -> Array:
    """Return unit vectors spread over the sphere by the golden angle, shape (3, count)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turns, across = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count), np.sqrt(1.0 - z**2)
    return np.array([across * np.cos(turns), across * np.sin(turns), z])


def _hull(points: Array) -> tuple[Array, Array]:
    """Return corners and face planes of the convex hull of points, shape (v, 3) and (f, 4), m."""
    # Not at the top: it takes 0.1 s to load, and a box does not need it.
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise ObjectModelError(
            f"{len(points)} points do not span a solid; give at least four that are not in "
            "one plane"
        ) from error
    # Each plane once; Qhull lists it for every triangle of a face.
    _, first = np.unique(hull.equations.round(9), axis=0, return_index=True)
    return points[hull.vertices], hull.equations[np.sort(first)]
