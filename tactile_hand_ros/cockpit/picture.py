# SPDX-License-Identifier: Apache-2.0
"""What a page shows of a hand: the newest ticks as rows of the columns that the report has too."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import BatchReader
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.control.grasp import required_friction
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.run.derived import rotation_between

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

KEPT = 2400
"""Rows that are kept: 20 s at 30 batches a second."""
ROWS_PER_BATCH = 4
"""Rows made of a batch: 120 a second, twice the pictures of a screen."""

_WINDOW = 500_000_000  # ns of values that are kept
_HOLD = 50_000_000  # ns that a value stands for a tick without one; then it is unknown
_ALIVE = 0.4  # s, twelve batches, without a message after which no row waits for a topic any more


class Track:
    """The newest values of a tick topic.

    Attributes:
        stamps: Timestamps in ascending order, ns, shape (n,).
        values: Numbers of each message, shape (n, width).
        received: When the last message came, s of the steady clock.
    """

    def __init__(self, kind: str, **groups: int) -> None:
        """Start empty, for a type and the groups of numbers to read, with their widths."""
        self._read, self._width = BatchReader(kind, groups), sum(groups.values())
        self.stamps, self.values = np.empty(0, np.int64), np.empty((0, self._width))
        self.received = -np.inf

    def take(self, messages: bytes) -> None:
        """Append a batch of `packed` messages; what was before time was set back is forgotten.

        Raises:
            MessageError: If a message is of another type or lacks a number.
        """
        stamps, values = self._read(messages)
        joined = np.concatenate([self.stamps, stamps])
        back = np.flatnonzero(joined[1:] < joined[:-1])
        start = int(back[-1]) + 1 if len(back) else 0
        self.stamps = joined[start:]
        self.values = np.concatenate([self.values, values])[start:]
        self.received = time.monotonic()

    def forget(self, stamp: int) -> None:
        """Forget what came before a stamp, ns."""
        start = int(self.stamps.searchsorted(stamp))
        self.stamps, self.values = self.stamps[start:], self.values[start:]

    def at(self, stamps: Stamps) -> Array:
        """Return the values at some stamps, shape (n, width); NaN where there is none."""
        if not len(self.stamps):
            return np.full((len(stamps), self._width), np.nan)
        rows = self.stamps.searchsorted(stamps, side="right") - 1
        known = (rows >= 0) & (stamps - self.stamps[rows.clip(0)] <= _HOLD)
        return np.where(known[:, None], self.values[rows.clip(0)], np.nan)


class Picture:
    """The newest rows of a hand since time was last set back, safe to read from another thread.

    Attributes:
        columns: Name and width of each column, in the order of a row.
        tracks: The newest values of each tick topic by name.
        desired: The target, position and quaternion, shape (7,); NaN if it is unknown.
        push: The last push, force and torque, shape (6,), N and N m; it ends at `push_end`, ns.
        epoch: Number of the picture, -1 if the joints are unknown and nothing is shown.
        total: Rows made.
        shown: The newest tick with a row, ns; -1 before the first.
    """

    def __init__(self, fingers: Sequence[str], joint_names: Sequence[str], epoch: int) -> None:
        """Start empty."""
        self.fingers, self.joint_names, self.epoch = tuple(fingers), tuple(joint_names), epoch
        self.total, self.desired, self.push = 0, np.full(7, np.nan), np.zeros(6)
        self.push_end, self.shown, self._taken = 0, -1, time.monotonic()
        k, m = len(fingers), len(joint_names)
        joint, pose = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
        self.tracks = {
            names.JOINT_STATES: Track(joint, position=m, velocity=m, effort=m),
            names.CONTACTS: Track("geometry_msgs/msg/PoseArray", poses=7 * k),
            names.GRIP_STATE: Track(joint, position=k, effort=k),
            names.TRUE_SLIP: Track(joint, velocity=k),
            names.AUXILIARY_POSE: Track(pose, pose=7),
            names.OBJECT_POSE: Track(pose, pose=7),
            names.IMU: Track("sensor_msgs/msg/Imu", orientation=4),
        }
        each = [topic(name) for name in fingers for topic in (names.wrench, names.optimal_force)]
        for topic in (names.GRASP_FORCE, *each):
            self.tracks[topic] = Track("geometry_msgs/msg/WrenchStamped", wrench=3)
        shapes = self._made(np.empty(0, np.int64))
        self.columns = {name: values.shape[1] for name, values in shapes.items()}
        self._lock = threading.Lock()
        self._times = np.empty(KEPT)
        self._rows = np.empty((KEPT, sum(self.columns.values())), np.float32)

    @property
    def stamp(self) -> int:
        """The newest tick, ns; 0 before the first."""
        stamps = self.tracks[names.JOINT_STATES].stamps
        return int(stamps[-1]) if len(stamps) else 0

    def take(self, batch: Mapping[str, bytes]) -> Iterator[MessageError]:
        """Read the `packed` messages of a batch by topic, and yield an error for a bad topic."""
        pause = time.monotonic() - self._taken if any(batch.values()) else 0.0
        self._taken += pause
        if pause > _ALIVE:  # nothing has moved; no topic has died meanwhile
            for track in self.tracks.values():
                track.received += pause
        for topic, track in self.tracks.items():
            try:
                if messages := batch.get(topic):
                    track.forget(self.shown - _WINDOW)
                    track.take(messages)
            except MessageError as error:
                yield MessageError(f"{topic}: {error}")

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
        rows, self.shown = np.hstack([*self._made(stamps).values()]), int(stamps[-1])
        with self._lock:
            places = (self.total + np.arange(len(stamps))) % KEPT
            self._times[places], self._rows[places] = 1e-9 * stamps, rows
            self.total += len(stamps)
        return True

    def _made(self, stamps: Stamps) -> dict[str, Array]:
        """Return the columns at some ticks, each of shape (n, width)."""
        at = {topic: track.at(stamps) for topic, track in self.tracks.items()}
        k, m, n = len(self.fingers), len(self.joint_names), len(stamps)
        states, pose, body = at[names.JOINT_STATES], at[names.AUXILIARY_POSE], at[names.OBJECT_POSE]
        contacts, grip = at[names.CONTACTS].reshape(n, k, 7), at[names.GRIP_STATE]
        forces = np.stack([at[names.wrench(name)] for name in self.fingers], axis=1)
        wanted = np.stack([at[names.optimal_force(name)][:, 1] for name in self.fingers], axis=1)
        grasp_force = at[names.GRASP_FORCE][:, 1:2]
        touching = np.isfinite(contacts[:, :, 0]) & np.isfinite(forces).all(axis=2)
        desired = np.tile(self.desired, (n, 1))
        turned = rotation_between(desired[:, 3:], pose[:, 3:])
        return {
            "theta": states[:, :m],
            "rates": states[:, m : 2 * m],
            "contact_positions": contacts[:, :, :3].reshape(n, 3 * k),
            "contact_quaternions": contacts[:, :, 3:].reshape(n, 4 * k),
            "auxiliary_position": pose[:, :3],
            "auxiliary_quaternion": pose[:, 3:],
            "desired_position": desired[:, :3],
            "desired_quaternion": desired[:, 3:],
            "object_position": body[:, :3],
            "object_quaternion": body[:, 3:],
            "position_error": np.linalg.norm(desired[:, :3] - pose[:, :3], axis=1, keepdims=True),
            "rotation_error": np.linalg.norm(turned, axis=1, keepdims=True),
            "force": known_part(forces).reshape(n, 3 * k),
            "expected": grasp_force * wanted,
            "beta": np.where(touching, required_friction(forces), np.nan),
            "friction": grip[:, :k],
            "grip": grip[:, k:],
            "grasp_force": grasp_force,
            "push": np.where(stamps < self.push_end, 1.0, 0.0)[:, None] * self.push,
            "palm": at[names.IMU],
        }

    def since(self, total: int) -> tuple[int, Array, NDArray[np.float32]]:
        """Return the rows made after the first `total` of this epoch, as far as they are kept.

        Returns:
            The number of rows made until now, times, shape (n,), s, and rows, shape (n, width).
        """
        with self._lock:
            places = np.arange(max(total, self.total - KEPT), self.total) % KEPT
            return self.total, self._times[places], self._rows[places]
