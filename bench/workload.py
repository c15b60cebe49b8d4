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
        seconds: Length of each run in real time [s].
        rates: Rates in real time [Hz].
    """

    scenario: Scenario
    record: Record
    repeats: int
    seconds: float
    rates: tuple[float, ...]

    @classmethod
    def prepare(
        cls, ticks: int | None, repeats: int, seconds: float, rates: tuple[float, ...]
    ) -> Workload:
        """Run the scenario once, over some ticks or all of its own."""
        scenario = load_scenario(SCENARIO)
        return cls(scenario, ClosedLoop(scenario).run(ticks), repeats, seconds, rates)

    @property
    def single(self) -> Scenario:
        """The scenario with one plant step a tick."""
        return self.scenario.changed({"plant.rate": 1.0 / self.scenario.plant.time_step})

    @property
    def grasps(self) -> list[Contacts]:
        """The contacts of each tick of the run."""
        pairs = zip(self.record.contact_positions, self.record.contact_quaternions, strict=True)
        return [Contacts.from_poses(*pair) for pair in pairs]
