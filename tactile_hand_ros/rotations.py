# SPDX-License-Identifier: Apache-2.0
"""Rotations: quaternions (x, y, z, w), matrices and vectors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tactile_hand_ros.compiled import Array, compiled

Vector = tuple[float, float, float]


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Convert quaternions (x, y, z, w), shape (..., 4), to rotation matrices, shape (..., 3, 3).

    The length of a quaternion does not matter. Rows with NaN, and zero quaternions, give NaN.
    """
    rows = np.ascontiguousarray(quaternion, dtype=np.float64)
    return rows_of_quaternions(rows.reshape(-1, 4)).reshape(rows.shape[:-1] + (3, 3))


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Convert rotation matrices, shape (..., 3, 3), to unit quaternions, shape (..., 4), w >= 0.

    Of the two quaternions of a half turn (w = 0) the one whose first non-zero component is
    positive is returned. Matrices with NaN give NaN.

    Source:
        S. W. Shepperd, Quaternion from rotation matrix, 1978: divides by the largest component.
    """
    matrices = np.ascontiguousarray(rotation, dtype=np.float64)
    return quaternions_of_rows(matrices.reshape(-1, 9)).reshape(matrices.shape[:-2] + (4,))


@compiled
def rows_of_quaternions(quaternions: Array) -> Array:
    """Return the rotations of quaternions, shape (n, 4), as rows of nine, shape (n, 9)."""
    out = np.empty((len(quaternions), 9))
    for i in range(len(quaternions)):
        x, y, z, w = quaternions[i]
        square = x * x + y * y + z * z + w * w
        s = 2.0 / square if square > 0.0 else np.nan
        sx, sy, sz = s * x, s * y, s * z
        xx, xy, xz, xw = x * sx, x * sy, x * sz, w * sx
        yy, yz, zz, yw, zw = y * sy, y * sz, z * sz, w * sy, w * sz
        out[i, 0], out[i, 1], out[i, 2] = 1.0 - yy - zz, xy - zw, xz + yw
        out[i, 3], out[i, 4], out[i, 5] = xy + zw, 1.0 - xx - zz, yz - xw
        out[i, 6], out[i, 7], out[i, 8] = xz - yw, yz + xw, 1.0 - xx - yy
    return out


@compiled
def quaternions_of_rows(rotations: Array) -> Array:
    """Return the quaternions, shape (n, 4), of rotations given as rows of nine, shape (n, 9)."""
    out = np.empty((len(rotations), 4))
    for row in range(len(rotations)):
        a, b, c, d, e, f, g, h, i = rotations[row]
        trace = a + e + i
        largest = max(trace, a, e, i)
        if largest == trace:
            x, y, z, w = h - f, c - g, d - b, 1.0 + trace
        elif largest == a:
            x, y, z, w = 1.0 + a - e - i, b + d, c + g, h - f
        elif largest == e:
            x, y, z, w = b + d, 1.0 - a + e - i, f + h, c - g
        else:
            x, y, z, w = c + g, f + h, 1.0 - a - e + i, d - b
        square = x * x + y * y + z * z + w * w
        scale = 1.0 / math.sqrt(square) if square > 0.0 else np.nan
        leading = w
        for component in (x, y, z):
            if leading == 0.0:
                leading = component
        if leading < 0.0:
            scale = -scale
        out[row, 0], out[row, 1], out[row, 2] = x * scale, y * scale, z * scale
        out[row, 3] = w * scale
    return out


@compiled
def dot(a: Array, b: Array) -> float:
    """Return the inner product of two vectors of shape (3,), summed in order."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def cross(a: Vector | Array, b: Vector | Array) -> Vector:
    """Return the cross product of two vectors given by their components."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def rotation_from_vector(vector: ArrayLike) -> Array:
    """Return the rotation by |vector| rad about vector, shape (3, 3) (Rodrigues 1840)."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return rodrigues(float(x), float(y), float(z))


@compiled
def rodrigues(x: float, y: float, z: float) -> Array:
    """Return the rotation about the vector (x, y, z) by its length, rad, shape (3, 3)."""
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle > 1e-4:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    else:  # their series, exact to rounding
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


@compiled
def vector_from_rotation(rotation: Array) -> Array:
    """Return the rotation vector of a rotation matrix, of length 0 to pi, shape (3,), rad."""
    x, y, z, w = quaternions_of_rows(np.ascontiguousarray(rotation).reshape(1, 9))[0]
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0
    return np.array([scale * x, scale * y, scale * z])
