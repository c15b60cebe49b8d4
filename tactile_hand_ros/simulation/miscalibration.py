# SPDX-License-Identifier: Apache-2.0
"""Contacts as the driver of a wrongly calibrated hand reports them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import contact_frame
from tactile_hand_ros.rotations import (
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
)
from tactile_hand_ros.simulation.skin import CalibrationConfig, TactileReading

if TYPE_CHECKING:  # a skin that is right does without the model
    from tactile_hand_ros.hand.hand import Hand

Array = NDArray[np.float64]


class Miscalibration:
    """Turns true contacts into those that the hand's model and mounting of the skin amount to."""

    def __init__(self, config: CalibrationConfig, known: Hand) -> None:
        """Take what is wrong.

        Args:
            config: The errors.
            known: The hand as its controllers know it.
        """
        self._hand = known
        self._turn = rotation_from_vector(config.skin_rotation)

    def step(self, theta: Array, true: TactileReading) -> TactileReading:
        """Return contacts p = p_f + r n and forces with the known p_f and r and a turned n.

        Args:
            theta: Joint angles, shape (m,), rad.
            true: The true contacts.
        """
        centres, tips = self._hand.tip_positions(theta), self._hand.tip_rotations(theta)
        turns = tips @ self._turn @ np.swapaxes(tips, 1, 2)
        positions, quaternions, forces = (
            true.positions.copy(),
            true.quaternions.copy(),
            true.forces.copy(),
        )
        for i in np.flatnonzero(np.isfinite(positions[:, 0])):
            frame = turns[i] @ rotation_from_quaternion(quaternions[i])
            seen = contact_frame(frame[:, 1])
            positions[i] = centres[i] + self._hand.radii[i] * frame[:, 1]
            quaternions[i] = quaternion_from_rotation(seen)
            forces[i] = seen.T @ frame @ forces[i]
        return TactileReading(positions, quaternions, forces)
