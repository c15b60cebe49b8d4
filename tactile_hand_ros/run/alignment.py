# SPDX-License-Identifier: Apache-2.0
"""From the topics of a hand to a `Record`: everything with the same stamp is one row."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.run.series import EARLY, Series
from tactile_hand_ros.run.topics import HandTopics

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Flags = NDArray[np.bool_]


def align(series: Mapping[str, Series], topics: HandTopics) -> Record:
    """Put messages side by side by their stamps.

    The ticks are the stamps of `joint_states`. Where a message was repeated the last one counts;
    where time was set back by a reset, only what came after it. Ticks that a topic does not have
    stay NaN.

    Args:
        series: Topics by full name.
        topics: Names of the hand's topics.
    """
    return _Alignment(series, topics).record()


def first_ticks(states: Series) -> tuple[Times, Times]:
    """Return the ticks of the last run in a bag and when each was first logged, ns."""
    start = last_reset(states.stamps)
    ticks, first = np.unique(states.stamps[start:], return_index=True)
    return ticks, states.log_times[start:][first]


def last_reset(stamps: Times) -> int:
    """Return the index of the first message after the last step back in time."""
    back = np.flatnonzero(np.diff(stamps) < 0)
    return int(back[-1]) + 1 if len(back) else 0


def in_last_run(series: Series, states: Series) -> Flags:
    """Return which messages of a topic belong to the last run in a bag, shape (n,).

    Args:
        series: The topic; it need not have a message at every tick.
        states: The topic `joint_states`.
    """
    _, logged = first_ticks(states)
    begin = int(logged[0]) - EARLY if len(logged) else 0
    return series.since(begin) & (np.arange(len(series)) >= last_reset(series.stamps))


class _Alignment:
    """The work of `align`, with what all its parts share."""

    def __init__(self, series: Mapping[str, Series], topics: HandTopics) -> None:
        self._series, self._topics = series, topics
        self._states = self._named(names.JOINT_STATES)
        self._ticks, self._logged = first_ticks(self._states)
        self._begin = int(self._logged[0]) - EARLY if len(self._logged) else 0
        self._joints = self._states.joint_names

    def _named(self, name: str) -> Series:
        return self._series[self._topics.full(name)]

    def record(self) -> Record:
        record = Record.empty(len(self._ticks), list(self._topics.fingers), self._joints)
        record.stamps[:] = self._ticks
        self._write_joints(record)
        self._write_grip(record)
        self._write_contacts(names.CONTACTS, record.contact_positions, record.contact_quaternions)
        self._write_contacts(names.TRUE_CONTACTS, record.true_positions, record.true_quaternions)
        self._write_forces(names.wrench, record.forces)
        self._write_forces(names.optimal_force, record.optimal_forces)
        self._write_forces(names.true_wrench, record.true_forces)
        squeeze = self._named(names.GRASP_FORCE)
        record.grasp_force[:] = self._placed(squeeze, squeeze.rows("wrench", 6))[:, 1]
        self._write_pose(
            names.AUXILIARY_POSE, record.auxiliary_position, record.auxiliary_quaternion
        )
        self._write_pose(names.OBJECT_POSE, record.object_position, record.object_quaternion)
        self._write_desired(record)
        return record

    def _placed(self, series: Series, values: Array) -> Array:
        """Return the values at the ticks, shape (ticks, columns), NaN where there are none."""
        out = np.full((len(self._ticks), values.shape[1]), np.nan)
        place = np.searchsorted(self._ticks, series.stamps)
        inside = (place < len(self._ticks)) & series.since(self._begin)
        inside[inside] = self._ticks[place[inside]] == series.stamps[inside]
        out[place[inside]] = values[inside]
        return out

    def _write_joints(self, record: Record) -> None:
        states, command = self._states, self._named(names.JOINT_COMMAND)
        for array, source, field in (
            (record.theta, states, "position"),
            (record.rates, states, "velocity"),
            (record.torque, states, "effort"),
            (record.command, command, "effort"),
        ):
            array[:] = self._placed(source, source.joints(field, self._joints))

    def _write_grip(self, record: Record) -> None:
        grip, slip = self._named(names.GRIP_STATE), self._named(names.TRUE_SLIP)
        for array, source, field in (
            (record.friction, grip, "position"),
            (record.slip_evidence, grip, "velocity"),
            (record.grip, grip, "effort"),
            (record.true_slid, slip, "position"),
            (record.true_sliding, slip, "velocity"),
        ):
            array[:] = self._placed(source, source.joints(field, record.finger_names))

    def _write_contacts(self, name: str, positions: Array, quaternions: Array) -> None:
        series, k = self._named(name), len(self._topics.fingers)
        poses = self._placed(series, series.rows("poses", 7 * k)).reshape(len(self._ticks), k, 7)
        poses[np.isnan(poses[:, :, :3]).all(axis=2)] = np.nan  # no contact has no frame either
        positions[:], quaternions[:] = poses[:, :, :3], poses[:, :, 3:]

    def _write_forces(self, topic: Callable[[str], str], forces: Array) -> None:
        for i, finger in enumerate(self._topics.fingers):
            series = self._named(topic(finger))
            forces[:, i] = self._placed(series, series.rows("wrench", 6))[:, :3]

    def _write_pose(self, name: str, position: Array, quaternion: Array) -> None:
        series = self._named(name)
        pose = self._placed(series, series.rows("pose", 7))
        position[:], quaternion[:] = pose[:, :3], pose[:, 3:]

    def _write_desired(self, record: Record) -> None:
        """Write the desired pose in force: it changes at the ticks at which one took effect."""
        series = self._named(names.ACCEPTED_POSE)
        poses = series.rows("pose", 7)
        for row in np.flatnonzero(in_last_run(series, self._states)):
            first = np.searchsorted(self._ticks, series.stamps[row])
            record.desired_position[first:] = poses[row, :3]
            record.desired_quaternion[first:] = poses[row, 3:]
