# SPDX-License-Identifier: Apache-2.0
"""Turn the topics of a bag into a `Record`: messages with the same timestamp form one row.

Nearly all messages of a topic have the same strings and lengths, so every number sits at the same
byte. One message is parsed for its layout; the others are read as columns of a byte table.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import TopicMessages, decode
from tactile_hand_ros.cdr import Table, header_stamp, is_reset, tables
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.errors import BagError

_TYPES = {
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.IMU: "sensor_msgs/msg/Imu",
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
    """The topics of one hand: their prefix, ``/`` or ``/left/``, and its fingers in array order."""

    prefix: str
    fingers: list[str]

    def full(self, name: str) -> str:
        """Return the full name of a relative topic."""
        return self.prefix + name

    def ordered(self, grips: Sequence[bytes]) -> HandTopics:
        """Return them with the fingers in the order of `grip_state`, which is that of the hand."""
        named = list(decode("sensor_msgs/msg/JointState", grips[0]).name) if grips else []
        return replace(self, fingers=named) if sorted(named) == sorted(self.fingers) else self

    @property
    def types(self) -> dict[str, str]:
        """Type of each topic by its full name."""
        found = {self.full(name): type_name for name, type_name in _TYPES.items()}
        for pattern in _FORCES.values():
            for finger in self.fingers:
                found[self.full(pattern(finger))] = "geometry_msgs/msg/WrenchStamped"
        return found


def find_prefix(topics: Iterable[str], namespace: str | None, bag: object) -> str:
    """Return the prefix of a hand's topics; `namespace` is None if there is only one hand.

    Raises:
        BagError: If there is no such hand, or more than one to choose from.
    """
    prefixes = [t.removesuffix(names.JOINT_STATES) for t in topics]
    hands = {prefix.strip("/"): prefix for prefix in prefixes if prefix.endswith("/")}
    wanted = next(iter(hands), "") if namespace is None and len(hands) < 2 else namespace
    if wanted is not None and wanted.strip("/") in hands:
        return hands[wanted.strip("/")]
    if not hands:
        raise BagError(f"The bag {bag} holds no run of a hand: it has no {names.JOINT_STATES}.")
    listed = ", ".join(sorted(hand or "/" for hand in hands))
    raise BagError(
        f"The bag {bag} has the topic {names.JOINT_STATES} of a hand in the namespaces: {listed}; "
        "choose one of them."
    )


def find_fingers(topics: Iterable[str], prefix: str) -> list[str]:
    """Return the fingers named in topics, shorter names first (finger_2 before finger_10)."""
    patterns = [re.escape(prefix) + p("([^/]+)") for p in _FORCES.values()]
    matches = (re.fullmatch(pattern, topic) for topic in topics for pattern in patterns)
    return sorted({m.group(1) for m in matches if m}, key=lambda name: (len(name), name))


Times = NDArray[np.int64]

EARLY = 100_000_000  # ns before the first tick of its run in which a message may be logged


def sections(messages: Mapping[str, TopicMessages], states: str) -> list[dict[str, TopicMessages]]:
    """Split the messages of a bag at its resets, oldest first.

    See `cdr.is_reset`.

    Raises:
        MessageError: If a message has no valid header.
    """
    stamps = [header_stamp(data) for data in messages[states].data]
    logged = messages[states].log_times[1:]
    starts = [
        at
        for at, before, after in zip(logged, stamps, stamps[1:], strict=False)
        if is_reset(before, after)
    ]
    bounds = {
        topic: [0, *(_first_of_section(each, start) for start in starts), len(each.data)]
        for topic, each in messages.items()
    }
    return [
        {topic: each.part(*bounds[topic][i : i + 2]) for topic, each in messages.items()}
        for i in range(len(starts) + 1)
    ]


def _first_of_section(messages: TopicMessages, start: int) -> int:
    """Return the index of the first message of the section whose first tick was logged at `start`.

    Topics may overtake each other. It is the message that steps back in time or, without one, the
    first within `EARLY`.
    """
    early = bisect_left(messages.log_times, start - EARLY)
    late = min(bisect_right(messages.log_times, start), len(messages.data) - 1)
    for i in range(late, max(early, 1) - 1, -1):
        if header_stamp(messages.data[i]) < header_stamp(messages.data[i - 1]):
            return i
    return early


@dataclass(frozen=True)
class Series:
    """The messages of one topic: log times and stamps, shape (n,), ns; grouped by layout."""

    log_times: Times
    stamps: Times
    tables: list[Table]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.stamps)

    def rows(self, name: str, count: int) -> Array:
        """Return a group of doubles per message, shape (n, count); NaN if their count differs."""
        out = np.full((len(self), count), np.nan)
        for table in self.tables:
            if table.layout.doubles[name][1] == count:
                out[table.rows] = table.doubles(name)
        return out

    @property
    def first_names(self) -> list[str]:
        """The names in the first JointState."""
        return next((t.layout.texts[1:] for t in self.tables if 0 in t.rows), [])

    def joints(self, name: str, joints: list[str]) -> Array:
        """Return a JointState field in the order of `joints`, shape (n, m); NaN if one lacks."""
        out = np.full((len(self), len(joints)), np.nan)
        for table in self.tables:
            given = table.layout.texts[1:]
            if table.layout.doubles[name][1] == len(given) and set(joints) <= set(given):
                order = [given.index(joint) for joint in joints]
                out[table.rows] = table.doubles(name)[:, order]
        return out


def read_series(
    messages: Mapping[str, TopicMessages], types: Mapping[str, str]
) -> dict[str, Series]:
    """Turn messages into arrays, by full name of the topic; raise MessageError if one is broken."""
    return {topic: _series(type_name, messages[topic]) for topic, type_name in types.items()}


def _series(type_name: str, messages: TopicMessages) -> Series:
    stamps = np.zeros(len(messages.data), dtype=np.int64)
    grouped = list(tables(type_name, messages.data))
    for table in grouped:
        stamps[table.rows] = table.stamps
    return Series(np.array(messages.log_times, dtype=np.int64), stamps, grouped)


def align(series: Mapping[str, Series], topics: HandTopics) -> Record:
    """Align the messages of all topics by their timestamps.

    The ticks are the timestamps of `joint_states`. The last of several messages for a tick counts;
    a tick without a message is NaN.
    """
    states = series[topics.full(names.JOINT_STATES)]
    ticks, _ = first_ticks(states)
    # Of a driver's joints, in any order, those that the hand drives, in its order.
    own, given = series[topics.full(names.JOINT_COMMAND)].first_names, states.first_names
    joints = own if own and set(own) <= set(given) else given
    fingers = topics.fingers
    record = Record.empty(len(ticks), list(fingers), joints)
    record.stamps[:] = ticks

    def of(name: str, rows: Callable[..., Array], *what: Any) -> Array:
        """Return values of a topic at the ticks."""
        one = series[topics.full(name)]
        return _at_ticks(one, rows(one, *what), ticks)

    for array, (name, values, owners) in _BY_NAME.items():
        order = joints if owners == "joints" else fingers
        getattr(record, array)[:] = of(name, Series.joints, values, order)
    for array, topic in _FORCES.items():
        for i, finger in enumerate(fingers):
            getattr(record, array)[:, i] = of(topic(finger), Series.rows, "wrench", 6)[:, :3]
    record.palm[:] = of(names.IMU, Series.rows, "orientation", 4)
    record.grasp_force[:] = of(names.GRASP_FORCE, Series.rows, "wrench", 6)[:, 1]
    for array, name in _CONTACTS.items():
        k = len(fingers)
        poses = of(name, Series.rows, "poses", 7 * k).reshape(len(ticks), k, 7)
        poses[np.isnan(poses[:, :, :3]).all(axis=2)] = np.nan  # no contact, no contact frame
        getattr(record, f"{array}_positions")[:] = poses[:, :, :3]
        getattr(record, f"{array}_quaternions")[:] = poses[:, :, 3:]
    for array, name in _POSES.items():
        pose = of(name, Series.rows, "pose", 7)
        getattr(record, f"{array}_position")[:] = pose[:, :3]
        getattr(record, f"{array}_quaternion")[:] = pose[:, 3:]
    _write_desired(record, series[topics.full(names.ACCEPTED_POSE)])
    return record


# Arrays of a record and their sources: topic, field, owners of the names in the message.
_BY_NAME = {
    "theta": (names.JOINT_STATES, "position", "joints"),
    "rates": (names.JOINT_STATES, "velocity", "joints"),
    "torque": (names.JOINT_STATES, "effort", "joints"),
    "command": (names.JOINT_COMMAND, "effort", "joints"),
    "friction": (names.GRIP_STATE, "position", "fingers"),
    "slip_evidence": (names.GRIP_STATE, "velocity", "fingers"),
    "grip": (names.GRIP_STATE, "effort", "fingers"),
    "true_slid": (names.TRUE_SLIP, "position", "fingers"),
    "true_sliding": (names.TRUE_SLIP, "velocity", "fingers"),
}
_FORCES = {
    "forces": names.wrench,
    "optimal_forces": names.optimal_force,
    "true_forces": names.true_wrench,
}
_CONTACTS = {"contact": names.CONTACTS, "true": names.TRUE_CONTACTS}
_POSES = {"auxiliary": names.AUXILIARY_POSE, "object": names.OBJECT_POSE}


def _at_ticks(series: Series, values: Array, ticks: Times) -> Array:
    """Return one row per tick, NaN without a message; the last of several messages counts."""
    out = np.full((len(ticks), values.shape[1]), np.nan)
    place = np.searchsorted(ticks, series.stamps)
    inside = place < len(ticks)
    inside[inside] = ticks[place[inside]] == series.stamps[inside]
    out[place[inside]] = values[inside]
    return out


def _write_desired(record: Record, accepted: Series) -> None:
    """Write the desired pose of every tick: it holds from the tick at which it takes effect."""
    for stamp, pose in zip(accepted.stamps, accepted.rows("pose", 7), strict=True):
        first = np.searchsorted(record.stamps, stamp)
        record.desired_position[first:] = pose[:3]
        record.desired_quaternion[first:] = pose[3:]


def first_ticks(states: Series) -> tuple[Times, Times]:
    """Return the ticks of a run and when each was first logged, ns."""
    ticks, first = np.unique(states.stamps, return_index=True)
    return ticks, states.log_times[first]
