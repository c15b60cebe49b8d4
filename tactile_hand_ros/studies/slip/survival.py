# SPDX-License-Identifier: Apache-2.0
"""What a grasp can survive at all, by linear programming on the true load: apart from any law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.closed_loop.scenario import Scenario
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.simulation.disturbance import external_wrench
from tactile_hand_ros.studies.slip.least_squeeze import least_squeeze

Array = NDArray[np.float64]

_STEP, _MOST = 0.02, 400  # s between instants that are looked at, and about how many at most


@dataclass(frozen=True)
class Survival:
    """Whether the object can be held at all.

    Attributes:
        worst: Largest squeeze that was ever needed, the least sum of normal forces, N.
        time: When, s.
        limit: The crush limit, N.
    """

    worst: float
    time: float
    limit: float

    @property
    def possible(self) -> bool:
        """Whether a grasp inside the crush limit can carry every load of the run."""
        return self.worst <= self.limit


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


def survival(record: Record, scenario: Scenario) -> Survival:
    """Return the worst instant of a run: true load and friction, and the contacts of the grasp.

    Where a contact is lost, the last grasp with all of them counts: whether it had to be lost is
    the question.

    Args:
        record: The run, of which only the true contacts and the object's pose count.
        scenario: What was run.
    """
    whole = np.isfinite(record.true_positions[:, :, 0]).all(axis=1)
    grasps = np.maximum.accumulate(np.where(whole, np.arange(len(record)), 0))
    starts = [d.start for d in scenario.plant.disturbances]
    starts += [c.start for c in scenario.plant.friction_changes]
    step = max(_STEP, scenario.duration / _MOST)
    times = np.union1d(np.arange(0.0, scenario.duration, step), np.array(starts) + 1e-6)
    worst, when = 0.0, 0.0
    for time in times[times <= scenario.duration]:
        row = min(int(np.searchsorted(record.times, time)), len(record) - 1)
        # Of an event at once, the grasp that it finds.
        least = least_at(record, scenario, float(time), int(grasps[max(row - 1, 0)]))
        if least > worst:
            worst, when = least, float(time)
    return Survival(worst, when, scenario.slip_regulator.maximum)
