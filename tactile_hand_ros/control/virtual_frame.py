# SPDX-License-Identifier: Apache-2.0
"""The virtual frame R_pov: the orientation of the grasp, seen from its contact points alone."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    centred,
    check_spread,
    collinearity_margin,
    too_few,
)
from tactile_hand_ros.errors import CollinearContactsError
from tactile_hand_ros.rotations import cross

Array = NDArray[np.float64]

_OTHER_SIDE = np.array([1.0, -1.0, -1.0])  # turns r_z to the other side of the plane, and r_y
_CLEAR_MARGIN = 0.1  # collinearity margin above which three points make a good frame


class VirtualFrame:
    """Follows the orientation of a grasp from its contact points.

    For three contacts r_x points from contact 2 to contact 1, r_z is normal to their plane and
    r_y = r_z x r_x. The side of r_z is chosen along palm +z at the start and then kept, so that a
    grasp can turn upside down. For more than three contacts the frame of the first three at the
    start (of the three that are farthest from a line, where fingers stand in a row) is turned by
    the rotation that best fits all contacts to their first positions (Kabsch 1976).

    Source: Shaw-Cortez et al., section III; our generalisation for k > 3.
    """

    def __init__(self) -> None:
        """Start without a memory of a grasp."""
        self._side = 0.0
        self._start: tuple[Array, Array] | None = None

    def reset(self) -> None:
        """Forget the grasp: the next call starts a new one."""
        self.__init__()  # type: ignore[misc]

    def orientation(self, points: Array) -> Array:
        """Return R_pov = [r_x r_y r_z] in the palm frame, shape (3, 3).

        Args:
            points: Contact points in the palm frame, shape (k, 3), m.

        Raises:
            CollinearContactsError: If the contacts lie on a line.
            GraspError: If there are fewer than three.
        """
        if len(points) <= 3:
            return self._plane_frame(points)
        check_spread(points)
        arms = centred(points)
        if self._start is None:
            self._start = arms, self._plane_frame(_leading(points))
        return turned_frame(*self._start, arms)

    def _plane_frame(self, points: Array) -> Array:
        if len(points) < 3:
            raise too_few(points)
        frame, margin = _frame_of_plane(points)
        if margin < MIN_COLLINEARITY_MARGIN:
            raise CollinearContactsError.of(points)
        if self._side == 0.0:
            self._side = -1.0 if frame[2, 2] < 0.0 else 1.0
        return frame if self._side > 0.0 else frame * _OTHER_SIDE


def _leading(points: Array) -> Array:
    """Return the first three points, or the three farthest from a line where those are near one."""
    if collinearity_margin(points[:3]) >= _CLEAR_MARGIN:
        return points[:3]
    triples = (points[list(three)] for three in combinations(range(len(points)), 3))
    return max(triples, key=collinearity_margin)


@compiled
def orientation_error(actual: Array, desired: Array) -> Array:
    """Return r_d = sum over the axes of r x r_desired, shape (3,).

    It is 2 sin(angle) times the axis of the rotation from actual to desired, in palm axes.

    Args:
        actual: R_pov, shape (3, 3).
        desired: R_pod, shape (3, 3).

    Source: Shaw-Cortez et al., below equation (8).
    """
    out = np.zeros(3)
    for axis in range(3):
        a, b, c = actual[:, axis]
        x, y, z = desired[:, axis]
        p, q, r = cross((a, b, c), (x, y, z))
        out[0] += p
        out[1] += q
        out[2] += r
    return out


@compiled
def pose_error(position: Array, actual: Array, wanted: Array, desired: Array) -> Array:
    """Return p_d - p and the `orientation_error` of two poses, shape (6,), m and 1.

    Args:
        position: p, shape (3,), m.
        actual: R_pov, shape (3, 3).
        wanted: p_d, shape (3,), m.
        desired: R_pod, shape (3, 3).
    """
    out = np.empty(6)
    out[:3] = wanted - position
    out[3:] = orientation_error(actual, desired)
    return out


@compiled
def _frame_of_plane(points: Array) -> tuple[Array, float]:
    """Return [r_x r_y r_z] of the plane of three points and their collinearity margin.

    r_z is along (p_1 - p_2) x (p_1 - p_3); points on a line have no frame.
    """
    margin = collinearity_margin(points)
    if margin < MIN_COLLINEARITY_MARGIN:
        return np.full((3, 3), np.nan), margin
    a, b, c = points[0] - points[1]
    d, e, f = points[0] - points[2]
    length = math.sqrt(a * a + b * b + c * c)
    x0, x1, x2 = a / length, b / length, c / length
    u, v, w = cross((a, b, c), (d, e, f))
    length = math.sqrt(u * u + v * v + w * w)
    z0, z1, z2 = u / length, v / length, w / length
    y0, y1, y2 = cross((z0, z1, z2), (x0, x1, x2))
    return np.array([[x0, y0, z0], [x1, y1, z1], [x2, y2, z2]]), margin


@compiled
def turned_frame(before: Array, frame: Array, after: Array) -> Array:
    """Return a frame of centred points, shape (k, 3), where they have turned to others."""
    return best_rotation(before, after) @ frame


@compiled
def best_rotation(before: Array, after: Array) -> Array:
    """Return the rotation that best maps centred points to centred points (Kabsch 1976).

    Where a reflection would fit better, the direction of the least extent is turned round.
    """
    u, _, vt = np.linalg.svd(after.T @ before)
    product: Array = u @ vt
    (a, b, c), (d, e, f), (g, h, i) = product
    if a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0.0:
        u[:, 2] *= -1.0
        product = u @ vt
    return product
