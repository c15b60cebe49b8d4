# SPDX-License-Identifier: Apache-2.0
"""What the measurements work on."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

SCENARIO = "paper"


@dataclass(frozen=True)
class Workload:
    """What the measurements work on, prepared once, with everything compiled and warm.

    Attributes:
        scenario: The scenario.
        record: A run of it, from which inputs are taken.
        repeats: How often whole runs are repeated.
    """

    scenario: Scenario
    record: Record
    repeats: int

    @classmethod
    def prepare(cls, ticks: int | None = None, repeats: int = 3) -> Workload:
        """Run the scenario once.

        Args:
            ticks: Number of ticks, that of the scenario by default.
            repeats: How often whole runs are repeated.
        """
        scenario = load_scenario(SCENARIO)
        return cls(scenario, ClosedLoop(scenario).run(ticks), repeats)

    @property
    def grasps(self) -> list[Contacts]:
        """The contacts of each tick of the run."""
        pairs = zip(self.record.contact_positions, self.record.contact_quaternions, strict=True)
        return [Contacts.from_poses(*pair) for pair in pairs]
