# SPDX-License-Identifier: Apache-2.0
"""How hard a law pulls an object towards its target, from the law itself and not from a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import hand_jacobian
from tactile_hand_ros.control.laws import LAWS, LawInput
from tactile_hand_ros.hand.hand import Fingertips
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.plant import Plant

Array = NDArray[np.float64]


def translational_stiffness(scenario: Scenario, at: str = "tips") -> Array:
    """Return the force on the object per metre of position error, shape (3, 3), N/m.

    The forces are those whose joint torques equal the drive of the law at the start of the run:
    at the fingertip centers, where (8) is written, or at the contacts with the object.

    Args:
        scenario: Hand, object and law.
        at: ``tips`` or ``contacts``.
    """
    plant = Plant(scenario.plant)
    state, hand = plant.state, plant.hand
    tips = hand.fingertips(state.theta)
    config = scenario.manipulation_controller.law
    law = LAWS[config.name](config, hand.radii)
    law.seen = LawInput(tips, state.contacts, np.zeros((hand.fingers, 3)), grasp_force=0.0)
    points = tips.positions if at == "tips" else state.contacts.positions
    stiffness = np.empty((3, 3))
    for axis in range(3):
        wrench = np.zeros(6)
        wrench[axis] = config.k_p  # of an error of one metre along this axis
        stiffness[:, axis] = _resultant(tips, points, law.drive(wrench))
    return stiffness


def _resultant(tips: Fingertips, points: Array, torque: Array) -> Array:
    """Return the sum of the forces at points of the fingertips that joint torques amount to."""
    jacobian = hand_jacobian(tips, points, np.tile(np.eye(3), (len(points), 1, 1)))
    jacobian = jacobian.reshape(-1, len(torque))
    forces = np.linalg.lstsq(jacobian.T, torque, rcond=None)[0]
    return np.asarray(forces.reshape(-1, 3).sum(axis=0))
