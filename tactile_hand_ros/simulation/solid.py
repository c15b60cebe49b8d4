# SPDX-License-Identifier: Apache-2.0
"""The object's shape: a convex polyhedron, and its closest point to a fingertip."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.errors import ObjectModelError

Array = NDArray[np.float64]

_CENTERED = 0.01  # of the largest coordinate: error of the center of rounded vertices


class Shape(NamedTuple):
    """A convex polyhedron as arrays, in its own frame.

    Attributes:
        normals: Outward unit normals of the faces, shape (f, 3).
        offsets: Distances of the face planes from the origin, shape (f,), m.
        edge_normals: Outward normals, in its plane, of the edges of each face, shape (f, e, 3).
        edge_offsets: Their distances from the origin, shape (f, e), m; infinite where padded.
        edge_starts: One end of every edge, shape (g, 3), m.
        edge_vectors: From there to the other end, shape (g, 3), m.
    """

    normals: Array
    offsets: Array
    edge_normals: Array
    edge_offsets: Array
    edge_starts: Array
    edge_vectors: Array


@compiled
def closest_point(shape: Shape, point: Array) -> tuple[float, Array]:
    """Find the closest point of a solid to a point, shape (3,), m, in the frame of the solid.

    Returns:
        Signed distance in m, negative inside, and the outward unit vector from the solid to the
        point, shape (3,).
    """
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


class ConvexPolyhedron:
    """A convex polyhedron in its own frame.

    Attributes:
        vertices: Corners, shape (v, 3), m.
        normals: Outward unit normals of the faces, shape (f, 3).
        offsets: Distances of the face planes from the origin, shape (f,), m.
        edges: Pairs of corner indices, shape (e, 2).
        face_corners: Corner indices of each face in order around its normal.
        shape: The same as arrays for `closest_point`.
    """

    def __init__(self, vertices: Array, planes: Array | None = None) -> None:
        """Build the convex hull of a set of points.

        Args:
            vertices: Shape (v, 3), m.
            planes: Outward unit normals n and heights d with n . p + d = 0 on each face, shape
                (f, 4), if known; then all points must be corners.

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

    @classmethod
    def box(cls, size: Array) -> ConvexPolyhedron:
        """Return a box centered at the origin with the given edge lengths, shape (3,), m."""
        half = np.asarray(size, dtype=float) / 2.0
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        # In the order in which Qhull would find them.
        x, y, z = np.eye(3)
        normals = np.array([-z, -y, x, -x, y, z])
        return cls(signs * half, np.column_stack([normals, -np.abs(normals) @ half]))

    def gyration(self) -> Array:
        """Return the inertia of the uniform body per mass about the origin, shape (3, 3), m^2.

        The body is made of tetrahedra from the origin to triangles of its faces, of volume
        v = a . (b x c) / 6 and second moment v (a a^T + b b^T + c c^T + s s^T) / 20, s = a + b + c.

        Raises:
            ObjectModelError: If its center of mass is not at the origin.
        """
        volume, center, moment = 0.0, np.zeros(3), np.zeros((3, 3))
        for corners in self.face_corners:
            for i in range(1, len(corners) - 1):
                abc = self.vertices[corners[[0, i, i + 1]]]
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
        return Shape(self.normals, self.offsets, normals, offsets, starts, ends - starts)


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
    return points[hull.vertices], _merge_coplanar(hull.equations)


def _merge_coplanar(equations: Array) -> Array:
    """Return each plane once; Qhull lists it for every triangle of a face."""
    kept = np.empty_like(equations)
    count = 0
    for plane in equations:
        # Tighter than the tolerance that finds a face's corners, or faces would lose some.
        if not (np.abs(plane - kept[:count]).max(axis=1, initial=0.0) < 1e-9).any():
            kept[count] = plane
            count += 1
    return kept[:count].copy()
