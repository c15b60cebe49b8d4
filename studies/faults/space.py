# SPDX-License-Identifier: Apache-2.0
"""What can fail, how, while the hand does what, and how its nodes run: the cells of the campaign.

The words for faults are those of PX4's failure injection: off, stuck, garbage, wrong, slow,
delayed, intermittent. A node that is off is killed, one that is stopped gets SIGSTOP.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator
from typing import NamedTuple

SPREAD = 0.2
"""Simulated time over which the moments of faults are spread [s]."""

WAYS = ("in-process", "lockstep", "composed", "processes")
"""By direct calls, without a clock; in lockstep in processes; in real time in one process and in
processes."""

SITUATIONS = ("at rest", "moving", "lifting", "pulled", "heavy")
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

HAND = (SENSOR, REGULATOR, OPTIMIZER, CONTROLLER)
"""The nodes that are killed and stopped."""


class Cell(NamedTuple):
    """One fault of one component, in one situation and one way to run."""

    way: str
    situation: str
    component: str
    fault: str

    @property
    def is_death(self) -> bool:
        """Whether a node of the hand is killed or stopped."""
        return self.component in HAND and self.fault in ("off", STOPPED)

    def __str__(self) -> str:
        """Return the cell in words."""
        return f"{self.way}, {self.situation}: {self.component} {self.fault}"


def cells() -> list[Cell]:
    """Return all cells that exist."""
    return [
        Cell(way, situation, component, fault)
        for way, situation in itertools.product(WAYS, SITUATIONS)
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
        return way != "composed" and fault in ("off", STOPPED)
    return component in (RECORDER, USER, COMPUTER)


class Run(NamedTuple):
    """One injection: a cell, and the seed of its moment and of its noise."""

    cell: Cell
    seed: int

    @property
    def delay(self) -> float:
        """By how much the fault begins later than the first moment of its situation, s."""
        return random.Random(self.seed).uniform(0.0, SPREAD)

    @property
    def session(self) -> tuple[str, str]:
        """Runs with equal ones share the nodes, or the cores."""
        return self.cell.way, "" if self.cell.way == "in-process" else self.cell.situation

    @property
    def key(self) -> str:
        """Return what distinguishes the run from all others of a campaign."""
        return f"{'/'.join(self.cell)}/{self.seed}"


def sample(
    runs: int, seed: int, *, ways: tuple[str, ...] = WAYS, among: list[Cell] | None = None
) -> list[Run]:
    """Return a balanced sample: no cell comes twice more often than another.

    The runs that share a session follow each other; the sessions come in random order, so that what
    an interrupted campaign has done is a fair sample, too.

    Args:
        runs: Number of injections.
        seed: Seed of the choice, of the order and of each run.
        ways: Ways to run that take part.
        among: Cells to choose from; all by default.
    """
    chance = random.Random(seed)
    chosen = [cell for cell in (among or cells()) if cell.way in ways]
    drawn: list[Run] = []
    while len(drawn) < runs and chosen:
        chance.shuffle(chosen)
        drawn += [Run(cell, chance.randrange(2**31)) for cell in chosen[: runs - len(drawn)]]
    return list(_by_session(drawn, chance))


def _by_session(runs: list[Run], chance: random.Random) -> Iterator[Run]:
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault(run.session, []).append(run)
    order = list(groups)
    chance.shuffle(order)
    for key in order:
        yield from groups[key]
