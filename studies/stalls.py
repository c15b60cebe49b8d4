# SPDX-License-Identifier: Apache-2.0
"""Commands that stop for a while or are always late: does the guard keep the object?

It runs in-process, tick by tick and without a clock, so the results are the same on every computer.
During a stall only the plant and the guard run: no skin, no regulator, no controller.
`make study NAME=stalls` makes the table of docs/results/measurements.md.
"""

from __future__ import annotations

import itertools
from collections import deque
from typing import Any

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.command_guard import CommandGuard, GuardConfig, TorqueCommand
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.sweep.engine import LOST, REACHED, Point, Study
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.table import Table

_RECOVERY = 0.5  # s after a stall, and under a delay

GUARDS = {"no": False, "yes": True}
CASES = {
    "at rest": ("paper", 9.0),
    "moving": ("paper", 0.8),
    "moving, turning": ("waypoints", 8.8),
    "moving 0.2 kg": ("gravity", 1.5),
    "lifting 0.2 kg": ("lift", 2.1),
    "lifting 1 kg": ("heavy", 2.1),
    "a pull of 10 N begins": ("pull", 1.999),
    "a pull grows": ("pull", 5.5),
    "shaken": ("shake", 3.0),
}
"""Scenario, and the simulated time at which commands stop [s]."""
FAULTS = {f"{1e3 * seconds:g} ms": (seconds, 0) for seconds in (0.005, 0.05, 0.2, 1.0)}
FAULTS |= {f"{ticks} late": (0.0, ticks) for ticks in (1, 3, 4, 20)}
"""Time without commands [s], or delay of each command for half a second [ticks]."""


class GuardedLoop:
    """A closed loop with a guard for the joints, whose commands may be late or missing."""

    def __init__(
        self, scenario: Scenario, config: GuardConfig | None = None, *, guarded: bool = True
    ) -> None:
        """Build the loop of a scenario with its guard, with another guard, or with none.

        Without a guard the last torque acts until the next one.
        """
        self.loop = ClosedLoop(scenario)
        hand, plant = self.loop.plant.hand, self.loop.scenario.plant
        self.guard = CommandGuard(config or plant.guard, hand, plant.tick, plant.step)
        self.rate = plant.rate
        self._is_guarded = guarded
        self._row = Record.empty(1, hand.finger_names, hand.joint_names)
        self._waiting: deque[TorqueCommand] = deque()
        self._newest: TorqueCommand | None = None

    def tick(self, *, answers: bool = True, delay: int = 0) -> None:
        """Advance by one tick; its command arrives `delay` ticks later, if at all."""
        loop = self.loop
        if answers:
            command = loop.answer(self._row, 0)
            self._waiting.append(TorqueCommand(loop.stamp, command.torque))
        while len(self._waiting) > delay:
            self._newest = self._waiting.popleft()
        self.act()

    def act(self) -> None:
        """Apply the newest command to the joints for a tick, if the guard permits it."""
        loop, newest = self.loop, self._newest
        if not self._is_guarded and newest is not None:
            loop.drive(lambda *_: newest.torque)
            loop.controller.joints_held = False
            return
        stamp = loop.stamp
        loop.drive(lambda since, theta, rates: self.guard.step(stamp + since, theta, rates, newest))
        loop.controller.joints_held = self.guard.holding

    def run(self, seconds: float, *, answers: bool = True, delay: int = 0) -> None:
        """Advance by a simulated time [s], at least one tick."""
        for _ in range(max(1, round(seconds * self.rate))):
            self.tick(answers=answers, delay=delay)


class Watch:
    """Runs a loop and records the worst effects on the object from the start.

    Attributes:
        moved: Largest distance of the object from its initial position [m].
        slid: Largest distance that a contact has slid since then [m].
        peak: Largest sum of normal forces [N].
        is_diverged: Whether the simulation has diverged, because the object fell.
    """

    def __init__(self, guarded: GuardedLoop) -> None:
        """Store the initial position of the object."""
        self._guarded = guarded
        state = guarded.loop.state
        self._at, self._slid = state.position, state.slid
        self.moved = self.slid = self.peak = 0.0
        self.is_diverged = False

    def run(
        self, seconds: float, *, answers: bool = True, delay: int = 0, moves: bool = False
    ) -> None:
        """Continue until the simulation diverges; a commanded motion is not counted."""
        for _ in range(max(1, round(seconds * self._guarded.rate))):
            if self.is_diverged:
                return
            try:
                self._guarded.tick(answers=answers, delay=delay)
            except DivergedError:
                self.is_diverged = True
                return
            state = self._guarded.loop.state
            if not moves:
                self.moved = max(self.moved, float(np.linalg.norm(state.position - self._at)))
            self.slid = max(self.slid, float((state.slid - self._slid).max()))
            self.peak = max(self.peak, float(state.forces[:, 1].sum()))

    @property
    def is_lost(self) -> bool:
        """Whether a finger has lost contact, or the simulation has diverged."""
        return self.is_diverged or not bool(self._guarded.loop.state.contacts.all_touching)


def run_one(point: Point) -> dict[str, Any]:
    """Make commands fail in a case, observe for another half second, and return the results."""
    (name, moment), (stall, late) = CASES[point.values["case"]], FAULTS[point.values["fault"]]
    guarded = GuardedLoop(load_scenario(name), guarded=GUARDS[point.values["guard"]])
    guarded.run(moment)
    watch = Watch(guarded)
    if stall:
        watch.run(stall, answers=False)
    watch.run(_RECOVERY, delay=late, moves=bool(stall))
    measured = {"moved_m": watch.moved, "slid_m": watch.slid, "peak_N": watch.peak}
    return {**measured, "outcome": LOST if watch.is_lost else REACHED}


def study_of() -> Study:
    """Return the study of all cases with both guards and all faults."""
    space = {"case": tuple(CASES), "guard": tuple(GUARDS), "fault": tuple(FAULTS)}
    return Study({name: Choice(values) for name, values in space.items()}, run_one)


COLUMNS = ("", "guard", *FAULTS)


def rows(table: Table) -> list[list[str]]:
    """Return moved [mm] / slid [mm] / peak grasp force [N], with the columns of `COLUMNS`."""
    numbers = zip(1e3 * table["moved_m"], 1e3 * table["slid_m"], table["peak_N"], strict=True)
    cells = [
        f"{moved:.1f} / {slid:.1f} / {peak:.0f}" if outcome == REACHED else f"**{outcome}**"
        for outcome, (moved, slid, peak) in zip(table["outcome"], numbers, strict=True)
    ]
    heads = itertools.product(CASES, GUARDS)
    starts = range(0, len(cells), len(FAULTS))
    return [[*head, *cells[i : i + len(FAULTS)]] for head, i in zip(heads, starts, strict=True)]
