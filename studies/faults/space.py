# SPDX-License-Identifier: Apache-2.0
"""What can fail, how, while the hand does what, and how its nodes run: the cells of the campaign.

The words for faults are those of PX4's failure injection: off, stuck, garbage, wrong, slow,
delayed, intermittent. A node that is off is killed, one that is stopped gets SIGSTOP.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

SPREAD = 0.2
"""Simulated time over which the moments of faults are spread [s]."""

WAYS = ("in-process", "lockstep", "composed", "processes")
"""By direct calls, without a clock; in lockstep in processes; in real time in one process and in
processes."""

SITUATIONS = {
    "paper": ("at rest", "moving", "lifting", "pulled", "heavy"),
    "human": ("human, at rest", "human, turning", "human, lifting", "human, pulled"),
}
"""What the hand does, by the hand that does it."""

FAULTS = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
NONE = "none"
"""No fault: what the hand does in that way and situation anyway."""

JOINTS, FINGER, SKIN = "joint link", "skin of one finger", "skin of all fingers"
REGULATOR, OPTIMIZER, CONTROLLER = "regulator", "optimizer", "controller"
SENSOR, RECORDER, USER, COMPUTER = "sensor", "recorder", "user commands", "computer"
STOPPED = "stopped"

FAULTS_OF = {
    JOINTS: (*FAULTS, "clock step"),
    FINGER: FAULTS,
    SKIN: FAULTS,
    SENSOR: ("off", STOPPED),
    REGULATOR: (*FAULTS, STOPPED),
    OPTIMIZER: (*FAULTS, STOPPED),
    CONTROLLER: (*FAULTS, STOPPED),
    RECORDER: ("off", "stuck", "full disk"),
    USER: ("stuck", "garbage", "wrong", "delayed", "intermittent"),
    COMPUTER: ("starved", STOPPED),
}

DEADLY = ("off", STOPPED)
HAND = (SENSOR, REGULATOR, OPTIMIZER, CONTROLLER)
"""What nodes are killed and stopped by, and which ones."""


class Cell(NamedTuple):
    """One fault of one component, in one situation and one way to run."""

    way: str
    situation: str
    component: str
    fault: str

    @property
    def is_death(self) -> bool:
        """Whether a node of the hand is killed or stopped."""
        return self.component in HAND and self.fault in DEADLY


def cells(hands: Sequence[str] = tuple(SITUATIONS)) -> list[Cell]:
    """Return all cells that exist for some hands."""
    situations = itertools.chain.from_iterable(SITUATIONS[hand] for hand in hands)
    return [
        Cell(way, situation, component, fault)
        for way, situation in itertools.product(WAYS, situations)
        for component, faults in FAULTS_OF.items()
        for fault in (*faults, *((NONE,) if component in _bases(way) else ()))
        if _exists(way, component, fault)
    ]


def _bases(way: str) -> tuple[str, ...]:
    """Return the components with which the runs without a fault are counted."""
    return (JOINTS, FINGER, REGULATOR, USER) if way == "in-process" else (USER,)


def _exists(way: str, component: str, fault: str) -> bool:
    """Return whether a fault can be injected there.

    What travels on wires fails in-process only, where a node that is stopped is one that is off and
    the sensor is the skin. Nodes are killed and stopped where each has a process of its own.
    """
    if way == "in-process":
        at_hand = component not in (RECORDER, SENSOR)
        return at_hand and (fault != STOPPED or component == COMPUTER)
    if component in HAND or fault == STOPPED:
        return way != "composed" and fault in DEADLY
    return component in (RECORDER, USER, COMPUTER)


@dataclass(frozen=True)
class Injection:
    """One injection: its cell, and the seed of its moment and of its noise."""

    way: str
    situation: str
    component: str
    fault: str
    seed: int

    @property
    def delay(self) -> float:
        """By how much the fault begins later than the first moment of its situation, s."""
        return random.Random(self.seed).uniform(0.0, SPREAD)


def sample(runs: int, seed: int, among: Sequence[Cell]) -> list[Injection]:
    """Return a balanced sample: no cell comes twice more often than another.

    The runs that share nodes follow each other.

    Args:
        runs: Number of injections.
        seed: Seed of the choice and of each run.
        among: Cells to choose from.
    """
    chance, chosen = random.Random(seed), list(among)
    drawn: list[Injection] = []
    while len(drawn) < runs and chosen:
        chance.shuffle(chosen)
        drawn += [Injection(*cell, chance.randrange(2**31)) for cell in chosen[: runs - len(drawn)]]
    return sorted(drawn, key=lambda run: (run.way, run.situation))
