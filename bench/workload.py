# SPDX-License-Identifier: Apache-2.0
"""The workload of the benchmarks."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.scenario.scenario import Scenario


@dataclass(frozen=True)
class Workload:
    """The workload of the benchmarks; its run has compiled and warmed all code.

    Attributes:
        scenario: The scenario.
        record: A run of it that provides inputs.
        repeats: Number of repetitions of whole runs.
        seconds: Length of each run in real time [s].
        rates: Rates in real time [Hz].
    """

    scenario: Scenario
    record: Record
    repeats: int
    seconds: float
    rates: tuple[float, ...]

    @property
    def grasps(self) -> list[Contacts]:
        """The contacts of each tick of the run."""
        pairs = zip(self.record.contact_positions, self.record.contact_quaternions, strict=True)
        return [Contacts.from_poses(*pair) for pair in pairs]
