# SPDX-License-Identifier: Apache-2.0
"""What a grasp can survive at all, by linear programming on the true load: apart from any law."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from studies.slip.least_squeeze import least_squeeze
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.plant_config import external_wrench

Array = NDArray[np.float64]


def least_against(contacts: Contacts, position: Array, wrench: Array, friction: float) -> float:
    """Return the least squeeze against a wrench on the object about its centre of mass."""
    torque = wrench[3:] + np.cross(position - contacts.centroid, wrench[:3])
    return least_squeeze(contacts, -np.concatenate([wrench[:3], torque]), friction)


def least_at(record: Record, scenario: Scenario, time: float, row: int) -> float:
    """Return the least squeeze against the true load and friction of a time.

    Args:
        record: The run.
        scenario: What was run.
        time: Time of load and friction, s.
        row: Tick of the contacts and of the object's pose.
    """
    plant = scenario.plant
    contacts = Contacts.from_poses(record.true_positions[row], record.true_quaternions[row])
    wrench = external_wrench(plant.disturbances, time)
    wrench[:3] += plant.object.mass * np.array(plant.gravity)
    friction = plant.object.friction
    for change in plant.friction_changes:
        friction = change.friction if change.start <= time else friction
    return least_against(contacts, record.object_position[row], wrench, friction)
