# SPDX-License-Identifier: Apache-2.0
"""The assumptions A1 to A7 of a run: how far each was from breaking, and when it did.

Everything is computed from what the hand itself knows, joints and touch, so that a bag of a real
hand has them too.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
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

Array = NDArray[np.float64]

_ROWS = 1000  # about so many ticks are looked at where a tick costs kinematics
_SETTLING = 0.05  # s in which contacts only just close
_QUIET = 0.1  # N of net contact force that counts as no external load
_MIN_JOINT_MARGIN = 1e-3  # m/rad
_BALANCE = 1e-6


@dataclass(frozen=True)
class Assumption:
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

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; NaN becomes None."""
        plain = asdict(self)
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in plain.items()}


def assumptions(record: Record, hand: Hand) -> list[Assumption]:
    """Return the assumptions of a run and how each held.

    Args:
        record: The run.
        hand: The hand, in the layout of the run.
    """
    sparse = record.part(slice(None, None, max(1, len(record) // _ROWS)))
    return [
        _rolled(sparse, hand),
        _on_hemisphere(sparse, hand),
        _unloaded(sparse),
        _no_slip(record),
        _in_cones(record),
        _regular(sparse, hand),
        _fast_enough(record),
        _spread(sparse),
        _balanced(sparse),
    ]


def _line(
    name: str,
    meaning: str,
    margin: str,
    record: Record,
    values: Array,
    limit: float,
    below: bool = False,
) -> Assumption:
    looked = (record.times >= _SETTLING) & ~np.isnan(values)
    known, times = values[looked], record.times[looked]
    if not len(known):
        return Assumption(name, meaning, margin, math.nan, limit, below, math.nan, [])
    worst = float(known.max() if below else known.min())
    if math.isnan(limit):
        return Assumption(name, meaning, margin, worst, limit, below, math.nan, [])
    good = known < limit if below else known > limit
    return Assumption(
        name, meaning, margin, worst, limit, below, float(good.mean()), _intervals(times, ~good)
    )


def _intervals(times: Array, bad: NDArray[np.bool_]) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [(float(times[a]), float(times[b - 1])) for a, b in zip(edges[::2], edges[1::2])]


def _contacts(record: Record, row: int) -> Contacts | None:
    contacts = Contacts.from_poses(record.contact_positions[row], record.contact_quaternions[row])
    return contacts if contacts.touching.all() else None


def _each(record: Record, value: Any) -> Array:
    """Evaluate a function of contacts and row at each row with all contacts; NaN elsewhere."""
    out = np.full(len(record), np.nan)
    for row in range(len(record)):
        contacts = _contacts(record, row)
        if contacts is not None:
            out[row] = value(contacts, row)
    return out


def _on_tips(record: Record, hand: Hand) -> Array:
    """Return contact normals in the frames of their fingertips, shape (n, k, 3)."""
    seen = np.full((len(record), hand.fingers, 3), np.nan)
    for row in range(len(record)):
        contacts = _contacts(record, row)
        if contacts is not None:
            tips = hand.tip_rotations(record.theta[row])
            seen[row] = local_normals(contacts.normals, tips)
    return seen


def _rolled(record: Record, hand: Hand) -> Assumption:
    """How far the contacts wandered over their fingertips; faces end where touch cannot see."""
    seen = _on_tips(record, hand)
    first = np.flatnonzero(~np.isnan(seen[:, 0, 0]))
    start = seen[first[0]] if len(first) else np.full(3, np.nan)
    wander = (hand.radii * angles_between(seen, start)).max(axis=1)
    return _line(
        "A1", "rigid polyhedron, contacts on its faces", "contacts wandered over the tips, m",
        record, wander, math.nan, below=True,
    )  # fmt: skip


def _on_hemisphere(record: Record, hand: Hand) -> Assumption:
    angles = angles_between(_on_tips(record, hand), TIP)
    return _line(
        "A2", "contacts on the hemispheres of the tips", "angle left to their rim, rad",
        record, (0.5 * np.pi - angles).min(axis=1), 0.0,
    )  # fmt: skip


def _unloaded(record: Record) -> Assumption:
    def load(contacts: Contacts, row: int) -> float:
        wrench = net_wrench(contacts.positions, contacts.rotations, record.forces[row])
        return float(np.linalg.norm(wrench[:3]))

    return _line(
        "A3", "no external load", "net contact force, N",
        record, _each(record, load), _QUIET, below=True
    )  # fmt: skip


def _no_slip(record: Record) -> Assumption:
    evidence = np.where(record.grip == ContactState.UNKNOWN, 0.0, record.slip_evidence)
    left = 1.0 - evidence.max(axis=1)
    left[(record.grip == ContactState.SLIP).any(axis=1)] = 0.0
    left[(record.grip == ContactState.UNKNOWN).all(axis=1)] = np.nan
    return _line("A4", "no contact slips", "evidence left before an alarm, 1", record, left, 0.0)


def _in_cones(record: Record) -> Assumption:
    """How near a contact came to the cone of the friction that the hand took it for."""
    distances = cone_distances(record.forces, record.friction)
    distances[record.grip == ContactState.UNKNOWN] = np.nan
    known = ~np.isnan(distances).all(axis=1)
    nearest = np.full(len(record), np.nan)
    nearest[known] = np.nanmin(distances[known], axis=1)
    return _line(
        "A4 cone", "forces inside the estimated cones", "minimum mu f_n - |f_t|, N",
        record, nearest, math.nan,
    )  # fmt: skip


def _regular(record: Record, hand: Hand) -> Assumption:
    def margin(contacts: Contacts, row: int) -> float:
        tips = hand.fingertips(record.theta[row])
        return joint_margin(hand_jacobian(tips, contacts.positions, contacts.rotations))

    return _line(
        "A5", "the joints can move every contact", "minimum singular value of J_h, m/rad",
        record, _each(record, margin), _MIN_JOINT_MARGIN,
    )  # fmt: skip


def _fast_enough(record: Record) -> Assumption:
    slips = record.grip == ContactState.SLIP
    lasted = np.zeros(len(record))
    steps = np.diff(record.times, prepend=record.times[:1])
    for i in range(1, len(record)):
        lasted[i] = lasted[i - 1] + steps[i] if slips[i].any() else 0.0
    lasted[np.isnan(record.grip).any(axis=1)] = np.nan
    return _line(
        "A6", "slip prevention is fast enough", "time left to end a slip, s",
        record, REACTION - lasted, 0.0,
    )  # fmt: skip


def _spread(record: Record) -> Assumption:
    margins = np.zeros(len(record))
    for row in range(len(record)):
        contacts = _contacts(record, row)
        if contacts is not None:
            margins[row] = collinearity_margin(contacts.positions)
    return _line(
        "A7", "three contacts off a line", "second to first extent of the contacts, 1",
        record, margins, MIN_COLLINEARITY_MARGIN,
    )  # fmt: skip


def _balanced(record: Record) -> Assumption:
    def residual(contacts: Contacts, row: int) -> float:
        forces = record.optimal_forces[row]
        wrench = net_wrench(contacts.positions, contacts.rotations, forces)
        return float(max(np.abs(wrench).max(), abs(forces[:, 1].sum() - 1.0)))

    return _line(
        "(13)", "f* is in balance and sums to 1", "residual, N and N m",
        record, _each(record, residual), _BALANCE, below=True,
    )  # fmt: skip
