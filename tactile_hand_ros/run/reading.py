# SPDX-License-Identifier: Apache-2.0
"""From the topics of a bag to a `Record`: everything with the same stamp is one row.

The topics of a hand become arrays, one row a message. The messages of a topic nearly always have
the same strings and lengths, so that every number sits at the same byte: one message is parsed for
its layout, and the rest is a table of bytes of which columns are read.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import TopicMessages
from tactile_hand_ros.cdr import Table, tables
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import BagError

_OF_FINGER = (names.wrench, names.optimal_force, names.true_wrench)
_TYPES = {
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.JOINT_COMMAND: "sensor_msgs/msg/JointState",
    names.CONTACTS: "geometry_msgs/msg/PoseArray",
    names.GRASP_FORCE: "geometry_msgs/msg/WrenchStamped",
    names.GRIP_STATE: "sensor_msgs/msg/JointState",
    names.ACCEPTED_POSE: "geometry_msgs/msg/PoseStamped",
    names.ACCEPTED_FORCE: "geometry_msgs/msg/WrenchStamped",
    names.AUXILIARY_POSE: "geometry_msgs/msg/PoseStamped",
    names.OBJECT_POSE: "geometry_msgs/msg/PoseStamped",
    names.TRUE_CONTACTS: "geometry_msgs/msg/PoseArray",
    names.TRUE_SLIP: "sensor_msgs/msg/JointState",
}


@dataclass(frozen=True)
class HandTopics:
    """The topics of one hand in a bag.

    Attributes:
        prefix: What stands before the relative names, ``/`` or ``/left/``.
        fingers: Names of the fingers in the order of all arrays.
    """

    prefix: str
    fingers: list[str]

    def full(self, name: str) -> str:
        """Return the full name of a relative topic."""
        return self.prefix + name

    @property
    def types(self) -> dict[str, str]:
        """Type of each topic by its full name."""
        found = {self.full(name): type_name for name, type_name in _TYPES.items()}
        for pattern in _OF_FINGER:
            for finger in self.fingers:
                found[self.full(pattern(finger))] = "geometry_msgs/msg/WrenchStamped"
        return found

    def check(self, types: Mapping[str, str]) -> None:
        """Insist that the topics have the types of the contract.

        Args:
            types: Types in the bag by full topic name.

        Raises:
            BagError: If one has another type, or there are commands without the ticks at which they
                took effect.
        """
        for topic, expected in self.types.items():
            if types.get(topic, expected) != expected:
                raise BagError(
                    f"The topic {topic} has the type {types[topic]}, expected {expected}; remap it "
                    "or record the right one."
                )
        sent, accepted = self.full(names.DESIRED_POSE), self.full(names.ACCEPTED_POSE)
        if sent in types and accepted not in types:
            raise BagError(
                f"The bag has {sent} but not {accepted}, which says when each pose took effect; "
                "record it again with this version, and with that topic."
            )


def find_prefix(topics: Iterable[str], namespace: str | None, bag: object) -> str:
    """Return what stands before the relative names of a hand's topics.

    Args:
        topics: Full names of all topics in the bag.
        namespace: The hand's namespace; None if there is only one hand.
        bag: Name of the bag, for the error text.

    Raises:
        BagError: If there is no such hand, or more than one to choose from.
    """
    known = sorted(
        t.removesuffix(names.JOINT_STATES) for t in topics if t.endswith("/" + names.JOINT_STATES)
    )
    hands = ", ".join(prefix.strip("/") or "/" for prefix in known)
    if not known:
        raise BagError(
            f"The bag {bag} has no topic {names.JOINT_STATES}, without which there are no ticks; "
            "record it along with the others."
        )
    if namespace is None:
        if len(known) > 1:
            raise BagError(f"The bag {bag} holds several hands; choose a namespace: {hands}.")
        return known[0]
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    if prefix not in known:
        raise BagError(f"The bag {bag} has no hand in the namespace '{namespace}', only: {hands}.")
    return prefix


def find_fingers(topics: Iterable[str], prefix: str) -> list[str]:
    """Return the fingers named in topics, in natural order (finger_2 before finger_10)."""
    patterns = [re.escape(prefix) + p("([^/]+)") for p in _OF_FINGER]
    found = {
        match.group(1)
        for topic in topics
        for pattern in patterns
        if (match := re.fullmatch(pattern, topic))
    }
    return sorted(found, key=_natural)


def _natural(name: str) -> list[tuple[int, str]]:
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


Array = NDArray[np.float64]
Times = NDArray[np.int64]


EARLY = 100_000_000
"""How long before the first tick of its run a message may have been logged [ns]."""


@dataclass(frozen=True)
class Series:
    """The messages of one topic.

    Attributes:
        log_times: When each was recorded, shape (n,), ns since the epoch.
        stamps: Its header stamp, the tick, shape (n,), ns.
        tables: The messages grouped by layout.
    """

    log_times: Times
    stamps: Times
    tables: list[Table]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.stamps)

    def since(self, log_time: int) -> NDArray[np.bool_]:
        """Return which messages were logged at or after a time, shape (n,)."""
        return np.asarray(self.log_times >= log_time)

    def rows(self, name: str, count: int) -> Array:
        """Return a group of doubles of every message, shape (n, count).

        Messages that hold another number of doubles give NaN.
        """
        out = np.full((len(self), count), np.nan)
        for table in self.tables:
            if table.layout.doubles[name][1] == count:
                out[table.rows] = table.doubles(name)
        return out

    def joints(self, name: str, joints: list[str]) -> Array:
        """Return a field of JointState messages in a given order of joints, shape (n, m).

        Messages without that field or with other joints give NaN.
        """
        out = np.full((len(self), len(joints)), np.nan)
        for table in self.tables:
            given = table.layout.texts[1:]
            if table.layout.doubles[name][1] == len(given) and sorted(given) == sorted(joints):
                order = [given.index(joint) for joint in joints]
                out[table.rows] = table.doubles(name)[:, order]
        return out

    @property
    def joint_names(self) -> list[str]:
        """Names in the first JointState."""
        return next((t.layout.texts[1:] for t in self.tables if 0 in t.rows), [])


def read_series(
    messages: Mapping[str, TopicMessages], types: Mapping[str, str], stop: int | None = None
) -> dict[str, Series]:
    """Turn the messages of topics into arrays.

    Args:
        messages: By full name of the topic.
        types: Type of each wanted topic by full name.
        stop: Log time at which a reset begins the next section, ns; None for the end of the bag.

    Raises:
        BagError: If a message is broken.
    """
    found = {}
    for topic, type_name in types.items():
        one = messages[topic]
        if stop is not None:
            one = _before(one, type_name, stop)
        found[topic] = _series(type_name, one)
    return found


def _before(messages: TopicMessages, type_name: str, stop: int) -> TopicMessages:
    """Leave out what belongs to the section that begins at a log time [ns].

    A node may have said something about it a little earlier.
    """
    early = part(messages, bisect_left(messages.log_times, stop))
    series = _series(type_name, early)
    back = np.flatnonzero(np.diff(series.stamps) < 0)
    if not len(back) or series.log_times[back[-1] + 1] < stop - EARLY:
        return early
    return part(early, int(back[-1]) + 1)


def part(messages: TopicMessages, end: int) -> TopicMessages:
    """Return the first messages."""
    return TopicMessages(messages.log_times[:end], messages.data[:end])


def _series(type_name: str, messages: TopicMessages) -> Series:
    stamps = np.zeros(len(messages.data), dtype=np.int64)
    grouped = list(tables(type_name, messages.data))
    for table in grouped:
        stamps[table.rows] = table.stamps
    return Series(np.array(messages.log_times, dtype=np.int64), stamps, grouped)


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
        for array, source, values in (
            (record.theta, states, "position"),
            (record.rates, states, "velocity"),
            (record.torque, states, "effort"),
            (record.command, command, "effort"),
        ):
            array[:] = self._placed(source, source.joints(values, self._joints))

    def _write_grip(self, record: Record) -> None:
        grip, slip = self._named(names.GRIP_STATE), self._named(names.TRUE_SLIP)
        for array, source, values in (
            (record.friction, grip, "position"),
            (record.slip_evidence, grip, "velocity"),
            (record.grip, grip, "effort"),
            (record.true_slid, slip, "position"),
            (record.true_sliding, slip, "velocity"),
        ):
            array[:] = self._placed(source, source.joints(values, record.finger_names))

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
