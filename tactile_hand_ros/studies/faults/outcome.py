# SPDX-License-Identifier: Apache-2.0
"""What became of the object and the hand after one injection."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.studies.faults.running_hand import Event, RunningHand
from tactile_hand_ros.studies.faults.space import Cell, Run

Array = NDArray[np.float64]

_LEAST = 0.1  # N; a hand that squeezes less has not begun to hold
LET_GO = 0.1  # m off its way: an object there is not in the hand, whatever touches it


@dataclass(frozen=True)
class Outcome:
    """What one injection did.

    Attributes:
        way, situation, component, fault: The cell.
        seed: Seed of the run.
        dropped: Whether a finger does not touch at the end, or the object is 0.1 m off its way.
        moved: Largest distance of the object from the straight way to its goal, m.
        safe: Time from the fault to the first hold or ERROR, s; None where none was declared.
        peak: Largest sum of normal forces, N.
        limit: The regulator's limit of it, N.
        recovered: Time from the end of the fault until the hand drives for good, s; None if it
            does not until the end.
        declared: What was declared first.
        lost_before: Whether the object was lost before anything failed, which the fault is not
            blamed for.
        error: Why the run could not be judged; empty if it was.
    """

    way: str
    situation: str
    component: str
    fault: str
    seed: int
    dropped: bool = False
    moved: float = 0.0
    safe: float | None = None
    peak: float = 0.0
    limit: float = 0.0
    recovered: float | None = None
    declared: str = ""
    lost_before: bool = False
    error: str = ""

    @property
    def cell(self) -> Cell:
        """The cell of the run."""
        return Cell(self.way, self.situation, self.component, self.fault)

    @property
    def key(self) -> str:
        """What distinguishes the run from all others of a campaign."""
        return Run(self.cell, self.seed).key

    def data(self) -> dict[str, Any]:
        """Return plain values by name."""
        return asdict(self)


def failed(run: Run, error: Exception) -> Outcome:
    """Return the outcome of a run that could not be judged."""
    return Outcome(*run.cell, run.seed, error=f"{type(error).__name__}: {error}"[:300])


def judge(hand: RunningHand, run: Run, begin: float, end: float) -> Outcome:
    """Return what became of a run.

    Args:
        hand: The hand with all events of the run.
        run: What was injected.
        begin: When the fault began, by the monotonic clock, s.
        end: When it ended, s.
    """
    after = hand.since(begin)
    before = [event for event in hand.events if event.time < begin]
    safe, declared = _first_declared(hand, after)
    off_way = _off_way(hand, begin)
    return Outcome(
        *run.cell,
        run.seed,
        dropped=not hand.is_touching(after) or off_way > LET_GO,
        moved=off_way,
        safe=None if safe is None else safe - begin,
        peak=hand.squeeze(after),
        limit=hand.scenario.slip_regulator.maximum,
        recovered=recovery(hand, after, end),
        declared=declared,
        lost_before=not hand.is_touching(before) or hand.squeeze(before[-200:]) < _LEAST,
    )


def _first_declared(hand: RunningHand, events: list[Event]) -> tuple[float | None, str]:
    """Return when the first hold or ERROR was declared, and by what."""
    holds = [(e.time, names.JOINT_HOLD) for e in _holds(hand, events)]
    found = sorted([*holds, *hand.errors(events)])
    return found[0] if found else (None, "")


def _holds(hand: RunningHand, events: list[Event]) -> list[Event]:
    return [e for e in events if e.topic == names.JOINT_HOLD and hand.read(e).data]


def _off_way(hand: RunningHand, begin: float) -> float:
    """Return the largest distance of the object from the straight line to its goal, m."""
    _, seen = hand.positions(hand.since(begin))
    _, all_seen = hand.positions(hand.events)
    if not len(seen) or not np.isfinite(seen).all():
        return math.inf
    here, start = seen[0], all_seen[0]
    targets = hand.scenario.targets
    goal = start + _way(targets[-1].position, hand) if targets else here
    return float(distance_to_segment(seen, here, goal).max())


def _way(position: Any, hand: RunningHand) -> Array:
    """Return the way of the object: that of the contacts, which begin at its centre of mass."""
    way: Array = np.subtract(position, hand.scenario.plant.object.position)
    return way


def distance_to_segment(points: Array, a: Array, b: Array) -> Array:
    """Return how far points are from the straight line between two others, shape (n,), m."""
    line = b - a
    length = float(line @ line)
    share = np.zeros(len(points)) if length < 1e-12 else (points - a) @ line / length
    nearest = a + np.clip(share, 0.0, 1.0)[:, None] * line
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def recovery(hand: RunningHand, events: list[Event], end: float) -> float | None:
    """Return how long after the end of the fault the hand drives for good, s; None if it does not.

    It drives while the joints are not held and the controller says what it believes of the object.
    """
    holds = [event for event in events if event.topic == names.JOINT_HOLD]
    if holds and hand.read(holds[-1]).data:
        return None
    free = max([end, *(event.time for event in holds)])
    beliefs = [e.time for e in events if e.topic == names.AUXILIARY_POSE and e.time >= free]
    return beliefs[0] - end if beliefs else None
