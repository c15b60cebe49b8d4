# SPDX-License-Identifier: Apache-2.0
"""Fingertips: their Jacobians out of what Pinocchio has left in its arrays, in one pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.compiled import compiled

Array = NDArray[np.float64]


class Fingertips(NamedTuple):
    """Fingertip centres and their Jacobians at one configuration, all in palm axes.

    Attributes:
        positions: Centres p_f, shape (k, 3), m.
        linear: Jacobians J of the centres' velocities, shape (k, 3, m).
        angular: Jacobians J_Omega of the tips' angular velocities, shape (k, 3, m).

    Source: Shaw-Cortez et al., equation (1).
    """

    positions: Array
    linear: Array
    angular: Array


@compiled
def tip_jacobians(
    spatial: Array, support: NDArray[np.bool_], centres: Array
) -> tuple[Array, Array]:
    """Return the Jacobians J and J_Omega of the fingertips, each of shape (k, 3, m), equation (1).

    Args:
        spatial: Velocities of the bodies at the palm's origin per joint rate, linear above angular,
            palm axes, shape (6, m).
        support: Which joints move which tip, shape (k, m).
        centres: Fingertip centres, palm frame, shape (k, 3), m.
    """
    k, m = support.shape
    linear, angular = np.zeros((k, 3, m)), np.zeros((k, 3, m))
    for i in range(k):
        x, y, z = centres[i]
        for j in range(m):
            if support[i, j]:
                a, b, c = spatial[3, j], spatial[4, j], spatial[5, j]
                linear[i, 0, j] = spatial[0, j] + b * z - c * y
                linear[i, 1, j] = spatial[1, j] + c * x - a * z
                linear[i, 2, j] = spatial[2, j] + a * y - b * x
                angular[i, 0, j], angular[i, 1, j], angular[i, 2, j] = a, b, c
    return linear, angular


def mirrored(upper: Array) -> Array:
    """Return the symmetric matrix of which the upper triangle is given, shape (m, m)."""
    return np.triu(upper) + np.triu(upper, 1).T


@compiled
def divide_by_inertia(upper: Array, right: Array) -> None:
    """Solve M x = b by Cholesky's U^T U = M for each column of an array, in place.

    Between joints of different fingers M is zero, and so is U: they are passed over.

    Args:
        upper: Symmetric positive definite M, of which the upper triangle counts, shape (m, m).
        right: Columns b, shape (m, n).
    """
    m = len(right)
    u = np.zeros((m, m))
    for i in range(m):
        for j in range(i, m):
            total = upper[i, j]
            for c in range(i):
                total -= u[c, i] * u[c, j]
            u[i, j] = math.sqrt(total) if i == j else total / u[i, i]
    for i in range(m):
        for c in range(i):
            if u[c, i] != 0.0:
                _take_away(right, i, u[c, i], c)
        right[i] /= u[i, i]
    for i in range(m - 1, -1, -1):
        for c in range(i + 1, m):
            if u[i, c] != 0.0:
                _take_away(right, i, u[i, c], c)
        right[i] /= u[i, i]


@compiled
def _take_away(rows: Array, row: int, factor: float, other: int) -> None:
    """Take a multiple of another row from a row."""
    for j in range(rows.shape[1]):
        rows[row, j] -= factor * rows[other, j]
