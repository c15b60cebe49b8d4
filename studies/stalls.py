# SPDX-License-Identifier: Apache-2.0
"""Commands that stop for a while or are always late: does the guard keep the object?

In the process, tick by tick and without a clock, so that the results are the same on every
computer. During a stall nothing but the plant and the guard runs: no skin, no regulator, no
controller. ``python -m studies.stalls`` prints the tables of docs/safe_hold.md.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.command_guard import CommandGuard, GuardConfig, TorqueCommand
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

LAST_TORQUE = GuardConfig(age_limit=1000)
"""As without a guard: the last torque acts for a second."""

_RECOVERY = 0.5  # s after a stall, and under a delay


@dataclass(frozen=True)
class Case:
    """A moment of a scenario at which commands stop."""

    name: str
    scenario: str
    time: float


CASES = (
    Case("at rest", "paper", 9.0),
    Case("moving", "paper", 0.8),
    Case("moving, turning", "waypoints", 8.8),
    Case("moving 0.2 kg", "gravity", 1.5),
    Case("lifting 0.2 kg", "lift", 2.1),
    Case("lifting 1 kg", "heavy", 2.1),
    Case("a pull of 10 N begins", "pull", 1.999),
    Case("a pull grows", "pull", 5.5),
    Case("shaken", "shake", 3.0),
)
STALLS = (0.005, 0.05, 0.2, 1.0)
DELAYS = (1, 3, 4, 20)


@dataclass(frozen=True)
class Outcome:
    """What became of the object.

    Attributes:
        moved: Largest distance of the object from where it was when the fault began, m.
        slid: Largest distance that a contact has slid since then, m.
        peak: Largest sum of normal forces, N.
        limit: The regulator's limit of it, N.
        is_dropped: Whether a finger does not touch at the end, or the simulation has diverged.
    """

    moved: float
    slid: float
    peak: float
    limit: float
    is_dropped: bool

    def __str__(self) -> str:
        """Return a cell of the table."""
        if self.is_dropped:
            return "**dropped**"
        return f"{1e3 * self.moved:.1f} / {1e3 * self.slid:.1f} / {self.peak:.0f}"


class GuardedLoop:
    """A closed loop whose commands reach the joints through a guard, late or not at all."""

    def __init__(self, scenario: Scenario, config: GuardConfig) -> None:
        """Build the loop of a scenario and the guard."""
        self.loop = ClosedLoop(scenario)
        hand, plant = self.loop.plant.hand, self.loop.scenario.plant
        self.guard = CommandGuard(config, hand, plant.tick)
        self.rate = plant.rate
        self._row = Record.empty(1, hand.finger_names, hand.joint_names)
        self._waiting: deque[TorqueCommand] = deque()
        self._newest: TorqueCommand | None = None

    def tick(self, *, answers: bool = True, delay: int = 0) -> None:
        """Move one tick ahead; the command of this one arrives some ticks later, if at all."""
        loop = self.loop
        if answers:
            command = loop.answer(self._row, 0)
            self._waiting.append(TorqueCommand(loop.stamp, command.torque))
        while len(self._waiting) > delay:
            self._newest = self._waiting.popleft()
        theta, rates = loop.state.theta, loop.state.rates
        loop.advance(self.guard.step(loop.stamp, theta, rates, self._newest))

    def run(self, seconds: float, *, answers: bool = True, delay: int = 0) -> None:
        """Move ahead by simulated time, at least one tick."""
        for _ in range(max(1, round(seconds * self.rate))):
            self.tick(answers=answers, delay=delay)


class Watch:
    """Runs a loop and keeps the worst of what the object suffers from now on."""

    def __init__(self, guarded: GuardedLoop) -> None:
        """Note where the object is."""
        self._guarded = guarded
        state = guarded.loop.state
        self._at, self._slid = state.position, state.slid
        self.moved = self.slid = self.peak = 0.0
        self.is_dropped = False

    def run(self, seconds: float, *, answers: bool, delay: int = 0, moves: bool = False) -> None:
        """Run on; a commanded move of the object does not count."""
        for _ in range(max(1, round(seconds * self._guarded.rate))):
            try:
                self._guarded.tick(answers=answers, delay=delay)
            except DivergedError:
                self.is_dropped = True
                return
            state = self._guarded.loop.state
            if not moves:
                self.moved = max(self.moved, float(np.linalg.norm(state.position - self._at)))
            self.slid = max(self.slid, float((state.slid - self._slid).max()))
            self.peak = max(self.peak, float(state.forces[:, 1].sum()))

    def outcome(self) -> Outcome:
        """Return what became of the object."""
        loop = self._guarded.loop
        is_dropped = self.is_dropped or not bool(loop.state.contacts.all_touching)
        limit = loop.scenario.slip_regulator.maximum
        return Outcome(self.moved, self.slid, self.peak, limit, is_dropped)


def stall(case: Case, seconds: float, config: GuardConfig) -> Outcome:
    """Return what a stall does: the distance moved in it, and the rest until half a second after.

    Args:
        case: When it begins.
        seconds: How long it lasts.
        config: The guard.
    """
    guarded = GuardedLoop(load_scenario(case.scenario), config)
    guarded.run(case.time)
    watch = Watch(guarded)
    watch.run(seconds, answers=False)
    if not watch.is_dropped:
        watch.run(_RECOVERY, answers=True, moves=True)
    return watch.outcome()


def delayed(case: Case, ticks: int, config: GuardConfig) -> Outcome:
    """Return what a constant delay of the commands does to the half second after its beginning."""
    guarded = GuardedLoop(load_scenario(case.scenario), config)
    guarded.run(case.time)
    watch = Watch(guarded)
    watch.run(_RECOVERY, answers=True, delay=ticks)
    return watch.outcome()


def main() -> None:
    """Print the tables: moved [mm] / slid [mm] / peak of the grasp force [N]."""
    print("| | guard |", " | ".join(f"{1e3 * s:g} ms" for s in STALLS), "| limit [N] |")
    print("|---" * (len(STALLS) + 3) + "|")
    for case, (name, config) in itertools.product(CASES, _GUARDS.items()):
        cells = [stall(case, seconds, config) for seconds in STALLS]
        print(f"| {case.name} | {name} |", " | ".join(map(str, cells)), f"| {cells[0].limit:g} |")
    print("\n| | guard |", " | ".join(f"{n} ticks" for n in DELAYS), "|")
    print("|---" * (len(DELAYS) + 2) + "|")
    for case, (name, config) in itertools.product(CASES, _GUARDS.items()):
        cells = [delayed(case, ticks, config) for ticks in DELAYS]
        print(f"| {case.name} | {name} |", " | ".join(map(str, cells)), "|")


_GUARDS = {"no": LAST_TORQUE, "yes": GuardConfig()}

if __name__ == "__main__":
    main()
