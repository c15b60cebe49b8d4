# SPDX-License-Identifier: Apache-2.0
"""The object's shape: a convex polyhedron and the point of it that is closest to a fingertip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tactile_hand_ros.core.errors import ObjectModelError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosestPoint:
    """Where a point outside a solid is closest to it.

    Attributes:
        normal: Outward unit vector from the solid to the point, shape (3,).
        distance: Signed distance in m, negative inside.
        on_face: Whether the closest feature is a face rather than an edge or a corner.
    """

    normal: Array
    distance: float
    on_face: bool


class ConvexPolyhedron:
    """A convex polyhedron in its own frame.

    Attributes:
        vertices: Corners, shape (v, 3), m.
        normals: Outward unit normals of the faces, shape (f, 3).
        offsets: Distances of the face planes from the origin, shape (f,), m.
        edges: Pairs of corner indices, shape (e, 2).
        face_corners: Corner indices of each face in order around its normal.
    """

    def __init__(self, vertices: Array) -> None:
        """Build the convex hull of a set of points.

        Args:
            vertices: Shape (v, 3), m.

        Raises:
            ObjectModelError: If the points do not span a volume.
        """
        points = np.asarray(vertices, dtype=float)
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError) as error:
            raise ObjectModelError(
                f"{len(points)} points do not span a solid; give at least four that are not in "
                "one plane"
            ) from error
        keep = hull.vertices
        self.vertices = points[keep]
        planes = _merge_coplanar(hull.equations)
        self.normals, self.offsets = planes[:, :3].copy(), -planes[:, 3]
        self.face_corners = [self._corners_of(f) for f in range(len(planes))]
        self.edges = self._edges()
        # Planes through the edges that bound each face, padded to equal number.
        self._edge_normals, self._edge_offsets = self._edge_planes()

    @classmethod
    def box(cls, size: Array) -> ConvexPolyhedron:
        """Return a box centred at the origin with the given edge lengths, shape (3,), m."""
        half = np.asarray(size, dtype=float) / 2.0
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return cls(signs * half)

    def closest(self, points: Array) -> list[ClosestPoint]:
        """Return where each point, given in the solid's frame, shape (k, 3), is closest to it."""
        heights = points @ self.normals.T - self.offsets
        return [self._closest(p, h) for p, h in zip(points, heights, strict=True)]

    def _closest(self, point: Array, heights: Array) -> ClosestPoint:
        face = int(heights.argmax())
        height = float(heights[face])
        # The nearest plane is the nearest face only if the foot of the perpendicular lies in it.
        if height <= 0.0 or self._inside(face, point):
            return ClosestPoint(self.normals[face], height, True)
        for other in np.flatnonzero(heights > 0.0):
            if other != face and self._inside(int(other), point):
                return ClosestPoint(self.normals[other], float(heights[other]), True)
        return self._closest_edge(point)

    def _inside(self, face: int, point: Array) -> bool:
        return bool((self._edge_normals[face] @ point <= self._edge_offsets[face]).all())

    def _closest_edge(self, point: Array) -> ClosestPoint:
        start, end = self.vertices[self.edges[:, 0]], self.vertices[self.edges[:, 1]]
        along = end - start
        s = np.einsum("ij,ij->i", point - start, along) / np.einsum("ij,ij->i", along, along)
        apart = point - (start + np.clip(s, 0.0, 1.0)[:, None] * along)
        distances = np.linalg.norm(apart, axis=1)
        i = int(distances.argmin())
        return ClosestPoint(apart[i] / distances[i], float(distances[i]), False)

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

    def _edge_planes(self) -> tuple[Array, Array]:
        longest = max(len(c) for c in self.face_corners)
        normals = np.zeros((len(self.face_corners), longest, 3))
        offsets = np.full((len(self.face_corners), longest), np.inf)
        for f, corners in enumerate(self.face_corners):
            start = self.vertices[corners]
            outward = np.cross(np.roll(start, -1, axis=0) - start, self.normals[f])
            outward /= np.linalg.norm(outward, axis=1)[:, None]
            normals[f, : len(corners)] = outward
            offsets[f, : len(corners)] = np.einsum("ij,ij->i", outward, start)
        return normals, offsets


def _merge_coplanar(equations: Array) -> Array:
    """Return each plane once; Qhull lists it for every triangle of a face."""
    kept: list[Array] = []
    for plane in equations:
        if not any(np.allclose(plane, other, atol=1e-9) for other in kept):
            kept.append(plane)
    return np.array(kept)
