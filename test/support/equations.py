# SPDX-License-Identifier: Apache-2.0
"""The paper's equations as they are printed, for tests to compare with.

Plain NumPy, without the package; docs/reference/equations.md names the code that runs.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def skew(a: Array) -> Array:
    """Return a^ with a^ b = a x b, shape (3, 3)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def hand_jacobian(centers: Array, linear: Array, angular: Array, points: Array) -> Array:
    """Return J_h of equation (2) in palm axes, shape (3k, m).

    Of p_f and p_c, shape (k, 3), m, and of J and J_Omega of the fingertips, shape (k, 3, m).
    """
    arms = points - centers
    return np.vstack([j - skew(p) @ w for j, w, p in zip(linear, angular, arms, strict=True)])


def grasp_map(points: Array, origin: Array) -> Array:
    """Return G of equation (4), or (11) about the centroid, for forces in palm axes, (6, 3k)."""
    blocks = [np.hstack([np.eye(3), -skew(point - origin)]).T for point in points]
    return np.hstack(blocks)


def virtual_frame(points: Array) -> Array:
    """Return R_pov = [r_x r_y r_z] of three points, r_z along palm +z, shape (3, 3)."""
    r_x = points[0] - points[1]
    r_z = np.cross(r_x, points[0] - points[2])
    r_z *= np.sign(r_z[2])
    r_x, r_z = r_x / np.linalg.norm(r_x), r_z / np.linalg.norm(r_z)
    return np.stack([r_x, np.cross(r_z, r_x), r_z], axis=1)


def rotation_error(points: Array, desired: Array) -> Array:
    """Return r_d = r_x x r_dx + r_y x r_dy + r_z x r_dz of three points, shape (3,)."""
    axes = zip(virtual_frame(points).T, desired.T, strict=True)
    return np.sum([np.cross(r, d) for r, d in axes], axis=0)
