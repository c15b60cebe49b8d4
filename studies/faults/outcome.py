# SPDX-License-Identifier: Apache-2.0
"""Outcome of one injection for the object and the hand."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from studies.faults import space
from studies.faults.running_hand import Received, RunningHand
from studies.faults.situations import expected
from studies.faults.space import Injection
from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array

_MINIMUM = 0.1  # N; below this sum of normal forces, the hand does not hold yet
_BEFORE = 0.1  # s before a fault during which the hand must hold the object
LET_GO = 0.1
"""Distance from its permitted positions at which the object counts as dropped [m]."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one injection.

    Attributes:
        dropped: Whether a finger does not touch at the end, or the object is 0.1 m away from its
            permitted positions.
        moved: Largest distance of the object from its permitted positions until the hand has
            recovered [m]; see `Expected`. NaN if a user moves it.
        safe: Time from the fault to the first hold or ERROR [s]; None without one.
        peak: Largest sum of normal forces [N].
        limit: The regulator's limit of it [N].
        recovered: Time from the end of the fault until the hand drives for good [s]; None if it
            does not recover.
        declared: The first hold or ERROR.
    """

    dropped: bool
    moved: float
    safe: float | None
    peak: float
    limit: float
    recovered: float | None
    declared: str


def why_not_begun(hand: RunningHand) -> str:
    """Return why the hand does not hold its object before a fault; empty if it does.

    It holds if all fingers touch and press, and the guard has not held the joints just before.
    """
    since = time.monotonic() - _BEFORE
    before = hand.since(since)
    holds = [event for event in hand.events if event.topic == names.JOINT_HOLD]
    if (holds and hand.read(holds[-1]).data) or _holds(hand, before):
        return "the joints are held"
    if not hand.is_touching(before):
        return "a finger does not touch"
    return "" if hand.grasp_force(before) >= _MINIMUM else "the fingers do not press"


def judge(hand: RunningHand, run: Injection, moment: float, begin: float, end: float) -> Outcome:
    """Return the outcome of a run with a fault at a simulated time `moment` [s].

    `begin` and `end` are the monotonic times of the start and the end of the fault [s].
    """
    after = hand.since(begin)
    recovered = recovery(hand, after, end)
    failing = [e for e in after if recovered is None or e.time <= end + recovered]
    holds = [(e.time, names.JOINT_HOLD) for e in _holds(hand, after)]
    safe, declared = min([*holds, *hand.errors(after)], default=(None, ""))
    moved = distance(run, hand.positions(failing)[1], moment)
    return Outcome(
        dropped=not hand.is_touching(after) or moved > LET_GO,
        moved=moved,
        safe=None if safe is None else safe - begin,
        peak=hand.grasp_force(after),
        limit=hand.scenario.slip_regulator.maximum,
        recovered=recovered,
        declared=declared,
    )


def distance(run: Injection, seen: Array, moment: float) -> float:
    """Return the distance of an object from its permitted positions [m]; NaN if a user moves it.

    Its observed positions have the shape (n, 3), m; `moment` is the simulated time of the fault.
    """
    if run.component == space.USER and run.fault in ("stuck", "delayed", "intermittent"):
        return math.nan  # motion toward a reachable command is no displacement
    return expected(run.situation, run.way).distance(seen, moment)


def _holds(hand: RunningHand, events: list[Received]) -> list[Received]:
    return [e for e in events if e.topic == names.JOINT_HOLD and hand.read(e).data]


def recovery(hand: RunningHand, events: list[Received], end: float) -> float | None:
    """Return the time from the end of the fault until the hand drives for good [s], or None.

    It drives if the joints are not held and the controller publishes its estimate of the object.
    """
    holds = [event for event in events if event.topic == names.JOINT_HOLD]
    if holds and hand.read(holds[-1]).data:
        return None
    free = max([end, *(event.time for event in holds)])
    beliefs = [e.time for e in events if e.topic == names.AUXILIARY_POSE and e.time >= free]
    return beliefs[0] - end if beliefs else None
