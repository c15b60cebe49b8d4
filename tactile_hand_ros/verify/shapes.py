# SPDX-License-Identifier: Apache-2.0
"""Rotations, extents and grasp maps at all ticks at once.

Independent of those that the nodes run, on purpose: a mistake would otherwise be made twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotations(quaternions: Array) -> Array:
    """Return rotation matrices of unit quaternions (x, y, z, w), shape (..., 3, 3)."""
    x, y, z, w = np.moveaxis(
        quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0
    )
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


def spread(positions: Array) -> Array:
    """Return the ratio of the second to the first extent of contact points, shape (n,)."""
    arms = positions - positions.mean(axis=1, keepdims=True)
    extents = np.linalg.svd(arms, compute_uv=False)
    return np.asarray(extents[:, 1] / extents[:, 0])


def grasp_maps(positions: Array) -> Array:
    """Return G~ about the centroid at every tick, shape (n, 6, 3k)."""
    n, k = positions.shape[:2]
    arms = positions - positions.mean(axis=1, keepdims=True)
    maps = np.zeros((n, 6, k, 3))
    maps[:, :3] = np.eye(3)[:, None, :]
    for axis in range(3):
        unit = np.eye(3)[axis]
        maps[:, 3:, :, axis] = np.cross(arms, unit).transpose(0, 2, 1)
    return np.asarray(maps.reshape(n, 6, 3 * k))
