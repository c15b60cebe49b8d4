# SPDX-License-Identifier: Apache-2.0
"""Fingertips: their Jacobians out of what Pinocchio has left in its arrays, in one pass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled

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
