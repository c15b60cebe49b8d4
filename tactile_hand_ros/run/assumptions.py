# SPDX-License-Identifier: Apache-2.0
"""The assumptions A1 to A7 of a run: how far each was from breaking, and when it did.

Everything is computed from what the hand itself knows, joints and touch, so that a bag of a real
hand has them too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts, hand_jacobian
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    collinearity_margin,
    joint_margin,
    net_wrench,
)
from tactile_hand_ros.control.margins import (
    REACTION,
    TIP,
    angles_between,
    cone_distances,
    local_normals,
)
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.derived import spans
from tactile_hand_ros.run.metrics import Plain

Array = NDArray[np.float64]

_ROWS = 1000  # about so many ticks are looked at where a tick costs kinematics
_SETTLING = 0.05  # s in which contacts only just close
_QUIET = 0.1  # N of net contact force that counts as no external load
_MIN_JOINT_MARGIN = 1e-3  # m/rad
_BALANCE = 1e-6


@dataclass(frozen=True)
class Assumption(Plain):
    """One assumption and how it held.

    Attributes:
        name: A1 to A7, or the solver.
        meaning: What is assumed.
        margin: What is looked at, with its unit.
        worst: Its worst value; NaN where nothing is known.
        limit: Value it must stay above, or below where `below`; NaN where touch knows no limit.
        below: Whether smaller is better.
        held_fraction: Fraction of the looked-at time in which it held; NaN where unknown.
        broken: Intervals in which it did not hold, start and end in s.
    """

    name: str
    meaning: str
    margin: str
    worst: float
    limit: float
    below: bool
    held_fraction: float
    broken: list[tuple[float, float]]


def assumptions(record: Record, hand: Hand) -> list[Assumption]:
    """Return the assumptions of a run and how each held.

    Args:
        record: The run.
        hand: The hand, in the layout of the run.
    """
    sparse = record.part(slice(None, None, max(1, len(record) // _ROWS)))
    return [_judged(line, record if line[-1] in _CHEAP else sparse, hand) for line in _LINES]


def _judged(line: _Line, record: Record, hand: Hand) -> Assumption:
    name, meaning, margin, limit, below, measure = line
    values = measure(record, hand)
    looked = (record.times >= _SETTLING) & ~np.isnan(values)
    known, times = values[looked], record.times[looked]
    held, worst, broken = math.nan, math.nan, []
    if len(known):
        worst = float(known.max() if below else known.min())
    if len(known) and not math.isnan(limit):
        good = known < limit if below else known > limit
        held = float(good.mean())
        broken = [(float(times[first]), float(times[after - 1])) for first, after in spans(~good)]
    return Assumption(name, meaning, margin, worst, limit, below, held, broken)


def _each(record: Record, value: Callable[[Contacts, int], Any], shape: tuple[int, ...]) -> Array:
    """Evaluate a function of contacts and row where all fingers touch; NaN elsewhere."""
    out = np.full((len(record), *shape), np.nan)
    for row in range(len(record)):
        positions, quaternions = record.contact_positions[row], record.contact_quaternions[row]
        contacts = Contacts.from_poses(positions, quaternions)
        if contacts.touching.all():
            out[row] = value(contacts, row)
    return out


def _on_tips(record: Record, hand: Hand) -> Array:
    """Return contact normals in the frames of their fingertips, shape (n, k, 3)."""
    return _each(
        record,
        lambda contacts, row: local_normals(
            contacts.normals, hand.tip_rotations(record.theta[row])
        ),
        (hand.fingers, 3),
    )


def _wandered(record: Record, hand: Hand) -> Array:
    """How far the contacts wandered over their fingertips; faces end where touch cannot see."""
    seen = _on_tips(record, hand)
    first = np.flatnonzero(~np.isnan(seen[:, 0, 0]))
    start = seen[first[0]] if len(first) else np.full(3, np.nan)
    return np.asarray((hand.radii * angles_between(seen, start)).max(axis=1))


def _to_rim(record: Record, hand: Hand) -> Array:
    return np.asarray((0.5 * np.pi - angles_between(_on_tips(record, hand), TIP)).min(axis=1))


def _load(record: Record, hand: Hand) -> Array:
    def load(contacts: Contacts, row: int) -> Any:
        wrench = net_wrench(contacts.positions, contacts.rotations, record.forces[row])
        return np.linalg.norm(wrench[:3])

    return _each(record, load, ())


def _before_alarm(record: Record, hand: Hand) -> Array:
    evidence = np.where(record.grip == ContactState.UNKNOWN, 0.0, record.slip_evidence)
    left = 1.0 - evidence.max(axis=1)
    left[(record.grip == ContactState.SLIP).any(axis=1)] = 0.0
    left[(record.grip == ContactState.UNKNOWN).all(axis=1)] = np.nan
    return np.asarray(left)


def _to_cone(record: Record, hand: Hand) -> Array:
    """How near a contact came to the cone of the friction that the hand estimates."""
    distances = cone_distances(record.forces, record.friction)
    distances[record.grip == ContactState.UNKNOWN] = np.nan
    return np.asarray(np.fmin.reduce(distances, axis=1, initial=np.nan))


def _levers(record: Record, hand: Hand) -> Array:
    def margin(contacts: Contacts, row: int) -> float:
        tips = hand.fingertips(record.theta[row])
        return joint_margin(hand_jacobian(tips, contacts.positions, contacts.rotations))

    return _each(record, margin, ())


def _to_end_of_slip(record: Record, hand: Hand) -> Array:
    slips = (record.grip == ContactState.SLIP).any(axis=1)
    lasted = np.zeros(len(record))
    steps = np.diff(record.times, prepend=record.times[:1])
    for i in range(1, len(record)):
        lasted[i] = lasted[i - 1] + steps[i] if slips[i] else 0.0
    lasted[np.isnan(record.grip).any(axis=1)] = np.nan
    return REACTION - lasted


def _spread(record: Record, hand: Hand) -> Array:
    """How far the contacts are from one line; 0 where one is missing."""
    spread = _each(record, lambda contacts, _: collinearity_margin(contacts.positions), ())
    return np.asarray(np.nan_to_num(spread))


def _residual(record: Record, hand: Hand) -> Array:
    def residual(contacts: Contacts, row: int) -> float:
        forces = record.optimal_forces[row]
        wrench = net_wrench(contacts.positions, contacts.rotations, forces)
        return float(max(np.abs(wrench).max(), abs(forces[:, 1].sum() - 1.0)))

    return _each(record, residual, ())


_Line = tuple[str, str, str, float, bool, Callable[[Record, Hand], Array]]
"""Name, meaning, margin, limit, whether smaller is better, and how the margin is measured."""

_LINES: tuple[_Line, ...] = (
    ("A1", "rigid polyhedron, contacts on its faces", "contacts wandered over the tips, m",
     math.nan, True, _wandered),
    ("A2", "contacts on the hemispheres of the tips", "angle left to their rim, rad",
     0.0, False, _to_rim),
    ("A3", "no external load", "net contact force, N", _QUIET, True, _load),
    ("A4", "no contact slips", "evidence left before an alarm, 1", 0.0, False, _before_alarm),
    ("A4 cone", "forces inside the estimated cones", "minimum mu f_n - |f_t|, N",
     math.nan, False, _to_cone),
    ("A5", "the joints can move every contact", "minimum singular value of J_h, m/rad",
     _MIN_JOINT_MARGIN, False, _levers),
    ("A6", "slip prevention is fast enough", "time left to end a slip, s",
     0.0, False, _to_end_of_slip),
    ("A7", "three contacts off a line", "second to first extent of the contacts, 1",
     MIN_COLLINEARITY_MARGIN, False, _spread),
    ("(13)", "f* is in balance and sums to 1", "residual, N and N m", _BALANCE, True, _residual),
)  # fmt: skip
_CHEAP = (_before_alarm, _to_cone, _to_end_of_slip)  # looked at at every tick
