# SPDX-License-Identifier: Apache-2.0
"""What the controllers of a recorded run heard, tick by tick, and what users asked of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.run.alignment import first_ticks, usable_poses
from tactile_hand_ros.run.run import Run

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

USER_FORCE = "user_grasp_force"
_EARLIER = 25  # ticks by which the order of two topics in a bag may be wrong
_LATER = 100  # ticks that a busy node may take to heed a message


@dataclass
class UserCommand:
    """Something that a user asked for.

    It is recorded when it was received, not at which tick the node heeded it: that is one of some
    ticks around, and shows in what the node answered.

    Attributes:
        value: A `Target`, or a squeeze in N.
        stamp: Tick from which it shall hold, ns; 0 for at once.
        first: First tick at which it can have been heeded, by row.
        last: Last tick at which it can have been heeded, by row.
        guess: Where it stands in the bag, by row.
    """

    value: Any
    stamp: int
    first: int
    last: int
    guess: int

    @property
    def certain(self) -> bool:
        """Whether its tick is known."""
        return self.first == self.last


@dataclass(frozen=True)
class Inputs:
    """The sensor topics of a run, and the wishes of its users.

    Attributes:
        record: All arrays, NaN where there is no message.
        contacts: Contacts of each tick, None where no message has come.
        felt: Ticks with a force of every finger, shape (n,).
        poses: Desired poses in order.
        forces: Requested squeezes in order.
        may_leave_out: Whether a node may have left out ticks, as in real time when it falls behind.
    """

    record: Record
    contacts: list[Contacts | None]
    felt: Flags
    poses: list[UserCommand]
    forces: list[UserCommand]
    may_leave_out: bool = False

    def heeded(self, answers: Array) -> Flags:
        """Return which ticks a node has not left out, shape (n,).

        Args:
            answers: What it said at each tick, NaN where it said nothing, shape (n, ...).
        """
        said: Flags = np.asarray(np.isfinite(answers.reshape(len(answers), -1)).any(axis=1))
        return said if self.may_leave_out else np.ones(len(said), dtype=np.bool_)


def read_inputs(run: Run) -> Inputs:
    """Collect the inputs of a run.

    Raises:
        BagError: If the bag cannot be read.
    """
    record = run.record
    series = run.series[run.topics.full(names.CONTACTS)]
    heard = np.isin(record.stamps, series.stamps)
    poses = zip(record.contact_positions, record.contact_quaternions, strict=True)
    contacts = [
        Contacts.from_poses(*pose) if known else None
        for pose, known in zip(poses, heard, strict=True)
    ]
    felt = np.asarray(np.isfinite(record.forces).all(axis=(1, 2)))
    is_realtime = run.scenario is not None and run.scenario.plant.pacing == "realtime"
    return Inputs(record, contacts, felt, _poses(run), _forces(run), is_realtime)


def _poses(run: Run) -> list[UserCommand]:
    ticks, logged = first_ticks(run.series[run.topics.full(names.JOINT_STATES)])
    series = run.series[run.topics.full(names.DESIRED_POSE)]
    rows = series.rows("pose", 7)
    wishes = []
    for row in np.flatnonzero(usable_poses(rows, series.frames)):
        target = Target(rows[row, :3].copy(), rotation_from_quaternion(rows[row, 3:]))
        wish = _wish(target, int(series.stamps[row]), int(series.log_times[row]), ticks, logged)
        wishes.append(wish)
    return wishes


def _forces(run: Run) -> list[UserCommand]:
    topic = run.topics.full(USER_FORCE)
    if topic not in run.summary.types:
        return []
    ticks, logged = first_ticks(run.series[run.topics.full(names.JOINT_STATES)])
    return [
        _wish(float(message.data), 0, log_time, ticks, logged)
        for _, log_time, message in read_messages(run.bag, [topic])
    ]


def _wish(
    value: Any,
    stamp: int,
    log_time: int,
    ticks: NDArray[np.int64],
    logged: NDArray[np.int64],
) -> UserCommand:
    seen = int(np.searchsorted(logged, log_time))
    if seen == 0:
        return UserCommand(value, stamp, 0, 0, 0)
    first, last = max(0, seen - _EARLIER), min(len(ticks) - 1, seen + _LATER)
    if stamp > int(ticks[last]):  # it had time to arrive, whenever that was
        return UserCommand(value, stamp, seen - 1, seen - 1, seen - 1)
    return UserCommand(value, stamp, first, last, min(seen, last))
