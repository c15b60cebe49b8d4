# SPDX-License-Identifier: Apache-2.0
"""The assumptions A1 to A7 of a run: how close each came to failing, and when it failed.

Computed from joint and touch data only, so that the bag of a real hand has them too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import MIN_COLLINEARITY_MARGIN, net_wrench
from tactile_hand_ros.control.margins import REACTION, GraspMonitor
from tactile_hand_ros.control.optimizer.cones import cone_distances
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.derived import spans

_ROWS = 1000  # approximate number of ticks for which kinematics is computed
_SETTLING = 0.05  # s, while contacts are still closing
_QUIET = 0.1  # N of net contact force that counts as no external load
_MIN_JOINT_MARGIN = 1e-3  # m/rad
_BALANCE = 1e-6


@dataclass(frozen=True)
class Assumption:
    """One assumption and how it held."""

    name: str
    meaning: str
    margin: str  # the quantity that is checked, with its unit
    worst: float  # NaN if unknown
    limit: float  # what the margin must stay above, or below; NaN if touch gives no limit
    below: bool  # whether smaller is better
    held_fraction: float  # of the checked time; NaN if unknown
    broken: list[tuple[float, float]]  # start and end, s


def assumptions(record: Record, hand: Hand) -> list[Assumption]:
    """Return the assumptions of a run and how each held; `hand` has the layout of the run."""
    sparse = record.part(slice(None, None, max(1, len(record) // _ROWS)))
    found = {name: (sparse.times, values) for name, values in _of_grasp(sparse, hand).items()}
    found |= {name: (record.times, values) for name, values in _of_slip(record).items()}
    return [_judged(line, *found[line[0]]) for line in _LINES]


def _judged(line: _Line, times: Array, values: Array) -> Assumption:
    name, meaning, margin, limit, below = line
    looked = (times >= times[0] + _SETTLING) & ~np.isnan(values)
    known, times = values[looked], times[looked]
    held, worst, broken = math.nan, math.nan, []
    if len(known):
        worst = float(known.max() if below else known.min())
    if len(known) and not math.isnan(limit):
        good = known < limit if below else known > limit
        held = float(good.mean())
        broken = [(float(times[first]), float(times[after - 1])) for first, after in spans(~good)]
    return Assumption(name, meaning, margin, worst, limit, below, held, broken)


def _of_grasp(record: Record, hand: Hand) -> dict[str, Array]:
    """Return the margins of postures and forces at each tick, by assumption."""
    monitor, names = GraspMonitor(hand), ("A1", "A2", "A3", "A5", "A7", "(13)")
    found = np.full((len(record), len(names)), np.nan)
    for row, theta in enumerate(record.theta):
        poses = record.contact_positions[row], record.contact_quaternions[row]
        contacts, optimal = Contacts.from_poses(*poses), record.optimal_forces[row]
        seen = monitor.margins(theta, contacts)
        net, residual = np.full(3, np.nan), np.full(6, np.nan)
        if contacts.all_touching:
            places = contacts.positions, contacts.rotations
            net = net_wrench(*places, record.forces[row])[:3]
            residual = net_wrench(*places, optimal)
        off = max(np.abs(residual).max(), abs(optimal[:, 1].sum() - 1.0))
        load = np.linalg.norm(net)
        found[row] = seen.face_travel, seen.hemisphere, load, seen.joint, seen.collinearity, off
    return dict(zip(names, found.T, strict=True))


def _of_slip(record: Record) -> dict[str, Array]:
    """Return the margins of friction and slip at each tick, by assumption.

    A4: the evidence left before an alarm, and the smallest distance of a contact to its estimated
    friction cone. A6: the time left to stop a slip.
    """
    unknown, slips = record.grip == ContactState.UNKNOWN, record.grip == ContactState.SLIP
    left = 1.0 - np.where(unknown, 0.0, record.slip_evidence).max(axis=1)
    left[slips.any(axis=1)] = 0.0
    left[unknown.all(axis=1)] = np.nan
    distances = cone_distances(record.forces, record.friction)
    distances[unknown] = np.nan
    time_left = np.full(len(record), REACTION)
    for first, after in spans(slips.any(axis=1)):
        time_left[first:after] -= record.times[first:after] - record.times[max(0, first - 1)]
    time_left[np.isnan(record.grip).any(axis=1)] = np.nan
    cone = np.fmin.reduce(distances, axis=1, initial=np.nan)
    return {"A4": left, "A4 cone": np.asarray(cone), "A6": time_left}


_Line = tuple[str, str, str, float, bool]
"""Name, meaning, margin, limit, and whether smaller is better."""

_LINES: tuple[_Line, ...] = (
    ("A1", "rigid polyhedron, contacts on its faces", "contact travel over the tips, m",
     math.nan, True),
    ("A2", "contacts on the hemispheres of the tips", "angle left to their rim, rad",
     0.0, False),
    ("A3", "no external load", "net contact force, N", _QUIET, True),
    ("A4", "no contact slips", "evidence left before an alarm, 1", 0.0, False),
    ("A4 cone", "forces inside the estimated cones", "minimum mu f_n - |f_t|, N",
     math.nan, False),
    ("A5", "the joints can move every contact", "minimum singular value of J_h, m/rad",
     _MIN_JOINT_MARGIN, False),
    ("A6", "slip prevention is fast enough", "time left to end a slip, s",
     0.0, False),
    ("A7", "three contacts off a line", "second to first extent of the contacts, 1",
     MIN_COLLINEARITY_MARGIN, False),
    ("(13)", "f* is in balance and sums to 1", "residual, N and N m", _BALANCE, True),
)  # fmt: skip
