# SPDX-License-Identifier: Apache-2.0
"""What a page shows of a hand: the newest ticks as rows of the columns that the report has too."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import Layout, Table, tables
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.control.grasp import required_friction
from tactile_hand_ros.errors import BagError, MessageError
from tactile_hand_ros.rotations import rotation_from_quaternion

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

KEPT = 2400
"""Rows that are kept: 20 s at 30 batches a second."""
ROWS_PER_BATCH = 4
"""Rows made of a batch: 120 a second, twice the pictures of a screen."""

_HOLD = 50_000_000  # ns that a value stands for a tick without one; then it is unknown
_ALIVE = 0.4  # s, twelve batches, without a message after which no row waits for a topic any more


class Track:
    """The newest values of a tick topic.

    Attributes:
        stamps: Timestamps in ascending order, ns, shape (n,).
        values: Numbers of each message, shape (n, width).
        new: Number of messages in the last batch.
        received: When the last message came, s of the steady clock.
    """

    def __init__(self, kind: str, groups: Mapping[str, int]) -> None:
        """Start empty, for a type and the groups of numbers to read, with their widths."""
        self._kind, self._groups, self._width = kind, groups, sum(groups.values())
        self._layout: Layout | None = None
        self._size = 0
        self._fixed, self._same = np.empty(0, np.int64), np.empty(0, np.uint8)
        self.stamps, self.values = np.empty(0, np.int64), np.empty((0, self._width))
        self.new, self.received = 0, -np.inf

    def take(self, messages: Sequence[bytes]) -> bool:
        """Append a batch; return whether time has been set back, which forgets what was before.

        Raises:
            MessageError: If a message is of another type or lacks a number.
        """
        stamps, values = self._read(messages)
        joined = np.concatenate([self.stamps, stamps])
        back = np.flatnonzero(np.diff(joined) < 0)
        start = int(back[-1]) + 1 if len(back) else 0
        self.stamps = joined[start:]
        self.values = np.vstack([self.values, values])[start:]
        self.new, self.received = min(len(stamps), len(self.stamps)), time.monotonic()
        return bool(len(back))

    def _read(self, messages: Sequence[bytes]) -> tuple[Stamps, Array]:
        """Return stamps, ns, shape (n,), and numbers, shape (n, width), oldest first."""
        try:
            found = self._tables(messages)
            rows = [
                np.hstack([table.doubles(name)[:, :width] for name, width in self._groups.items()])
                for table in found
            ]
        except (BagError, KeyError, ValueError) as error:
            raise MessageError(f"a message is not a {self._kind}: {error}") from None
        if wrong := [each.shape[1] for each in rows if each.shape[1] != self._width]:
            raise MessageError(f"a message has {wrong[0]} numbers, expected {self._width}")
        order = np.argsort(np.concatenate([table.rows for table in found]))
        return np.concatenate([t.stamps for t in found])[order], np.vstack(rows)[order]

    def _tables(self, messages: Sequence[bytes]) -> list[Table]:
        """Return the messages as tables; one table without parsing if their layout is known."""
        layout, joined = self._layout, b"".join(messages)
        if layout is not None and {len(data) for data in messages} == {self._size}:
            matrix = np.frombuffer(joined, np.uint8).reshape(-1, self._size)
            if bool(np.all(matrix.take(self._fixed, axis=1) == self._same)):
                return [Table(np.arange(len(matrix)), layout, matrix)]
        found = list(tables(self._kind, messages))
        self._layout, self._size = found[-1].layout, found[-1].matrix.shape[1]
        self._fixed = np.concatenate([np.arange(*ends) for ends in found[-1].layout.fixed])
        self._same = found[-1].matrix[0, self._fixed]
        return found

    def forget(self, stamp: int) -> None:
        """Forget what came before a stamp, ns, and what was new."""
        start = int(self.stamps.searchsorted(stamp))
        self.stamps, self.values, self.new = self.stamps[start:], self.values[start:], 0

    def at(self, stamps: Stamps) -> Array:
        """Return the values at some stamps, shape (n, width); NaN where there is none."""
        rows = self.stamps.searchsorted(stamps, side="right") - 1
        if not len(self.stamps):
            return np.full((len(stamps), self.values.shape[1]), np.nan)
        known = (rows >= 0) & (stamps - self.stamps[rows.clip(0)] <= _HOLD)
        return np.where(known[:, None], self.values[rows.clip(0)], np.nan)


def tracks_of(fingers: Sequence[str], joints: int) -> dict[str, Track]:
    """Return empty tracks of the tick topics of a hand with `joints` joints, by name."""
    k, joint, pose = len(fingers), "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
    found = {
        names.JOINT_STATES: Track(
            joint, {"position": joints, "velocity": joints, "effort": joints}
        ),
        names.CONTACTS: Track("geometry_msgs/msg/PoseArray", {"poses": 7 * k}),
        names.GRIP_STATE: Track(joint, {"position": k, "effort": k}),
        names.TRUE_SLIP: Track(joint, {"velocity": k}),
        names.AUXILIARY_POSE: Track(pose, {"pose": 7}),
        names.OBJECT_POSE: Track(pose, {"pose": 7}),
        names.IMU: Track("sensor_msgs/msg/Imu", {"orientation": 4}),
    }
    each = [topic(name) for name in fingers for topic in (names.wrench, names.optimal_force)]
    wrenches = [names.GRASP_FORCE, *each]
    return found | {
        topic: Track("geometry_msgs/msg/WrenchStamped", {"wrench": 3}) for topic in wrenches
    }


class Picture:
    """The newest rows of a hand, safe to read from another thread.

    Attributes:
        columns: Name and width of each column, in the order of a row.
        desired: The target, position and quaternion, shape (7,); NaN if it is unknown.
        push: The last push, force and torque, shape (6,), N and N m.
        epoch: How often time was set back.
        total: Rows made since the last time that happened.
        shown: The newest tick with a row, ns; -1 before the first.
    """

    def __init__(self, fingers: Sequence[str], joint_names: Sequence[str]) -> None:
        """Start empty."""
        self.fingers, self.joint_names = tuple(fingers), tuple(joint_names)
        k, m = len(fingers), len(joint_names)
        self.columns = {
            **{"theta": m, "rates": m, "contact_positions": 3 * k, "contact_quaternions": 4 * k},
            **{"auxiliary_position": 3, "auxiliary_quaternion": 4},
            **{"desired_position": 3, "desired_quaternion": 4},
            **{"object_position": 3, "object_quaternion": 4},
            **{"position_error": 1, "rotation_error": 1, "force": 3 * k, "expected": k},
            **{"beta": k, "friction": k, "grip": k, "grasp_force": 1, "push": 6, "palm": 4},
        }
        self._lock = threading.Lock()
        self._times = np.empty(KEPT)
        self._rows = np.empty((KEPT, sum(self.columns.values())), np.float32)
        self.epoch = 0
        self._forget()

    def _forget(self) -> None:
        self.total, self.desired, self.push = 0, np.full(7, np.nan), np.zeros(6)
        self.push_end, self.shown = 0, -1
        self.tracks = tracks_of(self.fingers, len(self.joint_names))

    def take(self, batch: Mapping[str, Sequence[bytes]]) -> Iterator[MessageError]:
        """Read the messages of a batch by topic, and yield an error for a bad topic."""
        for track in self.tracks.values():
            track.forget(self.shown - _HOLD)
        for topic, messages in batch.items():
            if not messages or topic not in self.tracks:
                continue
            try:
                is_set_back = self.tracks[topic].take(messages)
            except MessageError as error:
                yield MessageError(f"{topic}: {error}")
                continue
            if is_set_back and topic == names.JOINT_STATES:
                track = self.tracks[topic]
                with self._lock:
                    self.epoch += 1
                    self._forget()
                    self.tracks[topic] = track

    @property
    def stamp(self) -> int:
        """The newest tick, ns; 0 before the first."""
        stamps = self.tracks[names.JOINT_STATES].stamps
        return int(stamps[-1]) if len(stamps) else 0

    def advance(self) -> bool:
        """Make rows of the ticks of which everything has come that still comes.

        Returns:
            Whether there was one.
        """
        since = time.monotonic() - _ALIVE
        alive = [
            track.stamps[-1]
            for track in self.tracks.values()
            if track.received > since and len(track.stamps)
        ]
        ticks = np.unique(self.tracks[names.JOINT_STATES].stamps)
        ticks = ticks[(ticks > self.shown) & (ticks <= min(alive, default=-1))]
        if not len(ticks):
            return False
        chosen = np.linspace(0, len(ticks), min(len(ticks), ROWS_PER_BATCH) + 1).astype(int)[1:]
        stamps = ticks[chosen - 1]
        made, self.shown = self._made(stamps), int(stamps[-1])
        with self._lock:
            places = (self.total + np.arange(len(stamps))) % KEPT
            self._times[places], self._rows[places] = 1e-9 * stamps, made
            self.total += len(stamps)
        return True

    def _made(self, stamps: Stamps) -> Array:
        at = {topic: track.at(stamps) for topic, track in self.tracks.items()}
        k, n = len(self.fingers), len(stamps)
        contacts = at[names.CONTACTS].reshape(n, k, 7)
        forces = np.stack([at[names.wrench(name)] for name in self.fingers], axis=1)
        wanted = [at[names.optimal_force(name)][:, 1] for name in self.fingers]
        grasp_force = at[names.GRASP_FORCE][:, 1]
        touching = np.isfinite(contacts[:, :, 0]) & np.isfinite(forces).all(axis=2)
        desired, pose = np.tile(self.desired, (n, 1)), at[names.AUXILIARY_POSE]
        pushes = np.where(stamps < self.push_end, 1.0, 0.0)[:, None] * self.push
        return np.hstack([
            at[names.JOINT_STATES][:, : 2 * len(self.joint_names)],
            contacts[:, :, :3].reshape(n, -1),
            contacts[:, :, 3:].reshape(n, -1),
            pose,
            desired,
            at[names.OBJECT_POSE],
            np.linalg.norm(desired[:, :3] - pose[:, :3], axis=1, keepdims=True),
            _rotation_errors(desired[:, 3:], pose[:, 3:])[:, None],
            known_part(forces).reshape(n, -1),
            grasp_force[:, None] * np.stack(wanted, axis=1),
            np.where(touching, required_friction(forces), np.nan),
            at[names.GRIP_STATE],
            grasp_force[:, None],
            pushes,
            at[names.IMU],
        ])  # fmt: skip

    def since(self, total: int) -> tuple[int, Array, NDArray[np.float32]]:
        """Return the rows made after the first `total` of this epoch, as far as they are kept.

        Returns:
            The number of rows made until now, times, shape (n,), s, and rows, shape (n, width).
        """
        with self._lock:
            places = np.arange(max(total, self.total - KEPT), self.total) % KEPT
            return self.total, self._times[places], self._rows[places]


def _rotation_errors(desired: Array, actual: Array) -> Array:
    """Return |r_d|, twice the sine of the angle between quaternions, shape (n,)."""
    turn = rotation_from_quaternion(desired) @ np.swapaxes(rotation_from_quaternion(actual), 1, 2)
    parts = [turn[:, i, j] - turn[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return np.asarray(np.linalg.norm(parts, axis=0))
