# SPDX-License-Identifier: Apache-2.0
"""The cells of the campaign: component, fault, situation of the hand, and way to run its nodes.

The names of faults are those of PX4's failure injection: off, stuck, garbage, wrong, slow, delayed,
intermittent. A node that is off is killed; a node that is stopped gets SIGSTOP.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace

SPREAD = 0.2
"""Simulated time over which the moments of faults are spread [s]."""

WAYS = ("in-process", "lockstep", "composed", "processes")
"""In-process without a clock; processes in lockstep; real time in one process and in processes."""

SITUATIONS = {
    "paper": ("at rest", "moving", "lifting", "pulled", "heavy"),
    "human": ("human, at rest", "human, turning", "human, lifting", "human, pulled"),
}
"""Situations by hand."""

FAULTS = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
NONE = "none"
"""No fault: the baseline of a way and situation."""

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
"""The nodes that are killed and stopped, by the faults of `DEADLY`."""


@dataclass(frozen=True)
class Injection:
    """One fault of one component in one situation and one way to run: a cell of the campaign.

    Its seed determines its time and noise.
    """

    way: str
    situation: str
    component: str
    fault: str
    seed: int = 0

    @property
    def delay(self) -> float:
        """Delay of the fault after the earliest time of its situation [s]."""
        return random.Random(self.seed).uniform(0.0, SPREAD)


def cells(hands: Sequence[str] = tuple(SITUATIONS)) -> list[Injection]:
    """Return all cells for some hands, with seed 0."""
    situations = itertools.chain.from_iterable(SITUATIONS[hand] for hand in hands)
    return [
        Injection(way, situation, component, fault)
        for way, situation in itertools.product(WAYS, situations)
        for component, faults in FAULTS_OF.items()
        for fault in (*faults, *((NONE,) if component in _bases(way) else ()))
        if _exists(way, component, fault)
    ]


def _bases(way: str) -> tuple[str, ...]:
    """Return the components whose cells include runs without a fault."""
    return (JOINTS, FINGER, REGULATOR, USER) if way == "in-process" else (USER,)


def _exists(way: str, component: str, fault: str) -> bool:
    """Return whether a fault can be injected.

    Messages fail in-process only; there, a stopped node equals one that is off, and the sensor
    equals the skin. Nodes are killed and stopped only if each has its own process.
    """
    if way == "in-process":
        at_hand = component not in (RECORDER, SENSOR)
        return at_hand and (fault != STOPPED or component == COMPUTER)
    if component in HAND or fault == STOPPED:
        return way != "composed" and fault in DEADLY
    return component in (RECORDER, USER, COMPUTER)


def sample(runs: int, seed: int, among: Sequence[Injection]) -> list[Injection]:
    """Return a balanced sample of cells: their counts differ by at most one.

    Runs that share nodes are consecutive. The seed determines the choice and each run.
    """
    chance, chosen = random.Random(seed), list(among)
    drawn: list[Injection] = []
    while len(drawn) < runs and chosen:
        chance.shuffle(chosen)
        cut = chosen[: runs - len(drawn)]
        drawn += [replace(cell, seed=chance.randrange(2**31)) for cell in cut]
    return sorted(drawn, key=lambda run: (run.way, run.situation, run.component == RECORDER))
