# SPDX-License-Identifier: Apache-2.0
"""What the plant knows of touch, as it travels on topics."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.rotations import quaternions_of_rows
from tactile_hand_ros.simulation.plant import PlantState
from tactile_hand_ros.simulation.skin import TactileReading

Array = NDArray[np.float64]


def sliding_speeds(state: PlantState) -> Array:
    """Return how fast each contact slides, shape (k,), m/s."""
    return np.asarray(np.hypot(state.sliding[:, 0], state.sliding[:, 1]))


def true_reading(state: PlantState) -> TactileReading:
    """Return the true contacts of a plant's state as they travel on topics."""
    positions, rotations = state.contacts.positions, state.contacts.rotations
    return TactileReading(positions, *_felt(positions, rotations, state.forces))


@compiled
def _felt(positions: Array, rotations: Array, forces: Array) -> tuple[Array, Array]:
    """Return quaternions and forces of contacts, without a force where there is no contact."""
    felt = forces.copy()
    for i in range(len(felt)):
        if not math.isfinite(positions[i, 0]):
            felt[i] = 0.0
    return quaternions_of_rows(rotations.reshape(-1, 9)), felt
