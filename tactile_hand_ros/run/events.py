# SPDX-License-Identifier: Apache-2.0
"""Events of a run: commands, disturbances, slips, alarms, reactions, contacts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import TopicMessages, decode
from tactile_hand_ros.cdr import ContentReader
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.errors import BagError, MessageError
from tactile_hand_ros.run.derived import gaps, silent, spans
from tactile_hand_ros.scenario.scenario import Scenario


class Asked(NamedTuple):
    """A request or command that a node accepted or rejected."""

    stamp: int  # ns, the first tick that it could affect, or the last one before its rejection
    key: str  # the service, or the topic of the rejected command
    value: str  # of the request as text, or the reason for the rejection


def read_asked(messages: TopicMessages) -> list[Asked]:
    """Read an `accepted/<node>/requests` or `rejected/<node>`; raise BagError if it is broken."""
    decoded = [decode("diagnostic_msgs/msg/DiagnosticArray", one) for one in messages.data]
    if not all(each.status and each.status[0].values for each in decoded):
        raise BagError("A message about a user's request names none; expected a key and its value.")
    pairs = [(nanoseconds(each.header.stamp), each.status[0].values[0]) for each in decoded]
    return [Asked(stamp, pair.key, pair.value) for stamp, pair in pairs]


def releases(requests: Sequence[Asked]) -> list[float]:
    """Return when the hand was asked to open, s, except where a later grasp closed it again."""
    found: list[float] = []
    for each in requests:
        if each.key == "grasp":
            found = [1e-9 * each.stamp] if each.value == "false" else []
    return found


def nanoseconds(stamp: Any) -> int:
    """Return the timestamp of a message, ns."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


Flags = NDArray[np.bool_]

SLIDING = 1e-3  # m/s, minimum speed that counts as slip; slower is the creep of holding contacts
PAUSE = 0.02  # s, longest pause that does not split an event
RISE = 0.02  # relative rise of the grasp force that counts as a reaction
REACTION = 0.25  # s, longest time after a slip or an alarm in which a rise belongs to it


@dataclass(frozen=True)
class Event:
    """Something that happened at one simulated `time` [s], with a `text` for users.

    Kinds: ``slip`` is the true start of sliding, ``detection`` the alarm of the hand, ``reaction``
    the rise of the grasp force after it, ``request`` a service call by a user, ``refusal`` a
    rejected command, ``gap`` a stretch of ticks missing from the recording; also ``command``,
    ``disturbance``, ``contact_lost``, ``contact_made`` and ``dropped``.
    """

    time: float
    kind: str
    finger: str  # or link; empty if it concerns the whole hand
    text: str


def events(
    record: Record, scenario: Scenario | None = None, *, dropped: float = math.nan
) -> list[Event]:
    """Return the events of a run in order of time; without ground truth, none of kind ``slip``.

    `dropped` is the time of the drop, s; NaN if there was none.
    """
    found = [*_commands(record), *_of_fingers(record), *_reactions(record)]
    for first, last in gaps(record):
        lasted = record.times[last] - record.times[first]
        found += _at(record, [first], "gap", "", f"no data was recorded for {lasted:.3g} s")
    if not math.isnan(dropped):
        found.append(Event(dropped, "dropped", "", "the object is dropped"))
    if scenario is not None:
        found += _disturbances(scenario, *record.times[[0, -1]])
    return sorted(found, key=lambda event: event.time)


def asked_events(requests: Sequence[Asked], refusals: Sequence[Asked]) -> list[Event]:
    """Return the events of service calls and of rejected commands."""
    found: list[Event] = []
    for stamp, key, value in requests:
        text = f"a user calls {key}" + (f" ({value})" if value else "")
        if stamp or key != "enable":  # reported at the first tick, without a call
            found.append(Event(1e-9 * stamp, "request", "", text))
    for stamp, key, reason in refusals:
        found.append(Event(1e-9 * stamp, "refusal", "", f"{key} is rejected: {reason}"))
    return found


def read_pushes(messages: TopicMessages) -> list[Event]:
    """Return the pushes of users, each with its largest force; raise BagError if one is broken."""
    found: list[Event] = []
    read = ContentReader("geometry_msgs/msg/WrenchStamped")
    try:
        pushes = [read(data) for data in messages.data]
    except MessageError as error:
        raise BagError(f"A message of {names.PUSH} cannot be read: {error}") from None
    sizes = np.array([np.linalg.norm(push.doubles["wrench"][:3]) for push in pushes])
    for first, end in spans(sizes > 0.0):
        text = f"a user pushes with up to {sizes[first:end].max():.1f} N"
        found.append(Event(1e-9 * pushes[first].stamp, "disturbance", "", text))
    return found


def slip_count(record: Record) -> int:
    """Return how often a contact truly started to slide."""
    return sum(len(starts(record.times, column > SLIDING)) for column in record.true_sliding.T)


def alarm_count(record: Record) -> int:
    """Return how often the hand detected that a contact slips."""
    return sum(len(starts(record.times, column == ContactState.SLIP)) for column in record.grip.T)


def _commands(record: Record) -> list[Event]:
    desired = np.hstack([record.desired_position, record.desired_quaternion])
    known = np.isfinite(desired).all(axis=1)
    before = np.vstack([np.full((1, 7), np.nan), desired[:-1]])
    new = np.flatnonzero(known & (desired != before).any(axis=1))
    return _at(record, new, "command", "", "a new pose is commanded")


def _at(record: Record, rows: Iterable[int], kind: str, finger: str, text: str) -> list[Event]:
    return [Event(float(record.times[row]), kind, finger, text) for row in rows]


def _disturbances(scenario: Scenario, start: float, end: float) -> list[Event]:
    pushes = [
        Event(push.start, "disturbance", "", f"{push.kind} of {_strength(push.force, push.torque)}")
        for push in scenario.plant.disturbances
    ]
    changes = [
        Event(change.start, "disturbance", "", f"friction becomes {change.friction:g}")
        for change in scenario.plant.friction_changes
    ]
    return [event for event in pushes + changes if start <= event.time <= end]


def _strength(force: tuple[float, ...], torque: tuple[float, ...]) -> str:
    push, twist = float(np.linalg.norm(force)), float(np.linalg.norm(torque))
    parts = [f"{push:g} N"] if push or not twist else []
    return " and ".join([*parts, *([f"{twist:g} N m"] if twist else [])])


def _of_fingers(record: Record) -> list[Event]:
    found: list[Event] = []
    missing = np.isnan(record.contact_positions[:, :, 0])
    unknown = silent(record)
    for i, finger in enumerate(record.finger_names):
        name = finger.replace("_", " ")
        sliding = record.true_sliding[:, i] > SLIDING
        alarm = record.grip[:, i] == ContactState.SLIP
        away = spans(_held_through(missing[:, i], unknown))
        lost = [first for first, _ in away if first]
        made = [after for _, after in away if after < len(record)]
        slips, alarms = starts(record.times, sliding), starts(record.times, alarm)
        found += _at(record, slips, "slip", finger, f"{name} starts to slide")
        found += _at(record, alarms, "detection", finger, f"slip of {name} is detected")
        found += _at(record, lost, "contact_lost", finger, f"{name} loses contact")
        found += _at(record, made, "contact_made", finger, f"{name} touches")
    return found


def _held_through(flags: Flags, unknown: Flags) -> Flags:
    """Return flags that keep their last known value while unknown."""
    rows = np.maximum.accumulate(np.where(unknown, 0, np.arange(len(flags))))
    return np.asarray(flags[rows] & ~(unknown & (rows == 0)))


def starts(times: NDArray[np.floating[Any]], flags: Flags) -> list[int]:
    """Return the rows at which flags become set after a pause; the first row does not count.

    `times` [s] and `flags` have shape (n,).
    """
    found, ended = [], -math.inf
    for first, after in spans(flags):
        if first and times[first] - ended > PAUSE:
            found.append(first)
        ended = times[min(after, len(times) - 1)]
    return found


def _reactions(record: Record) -> list[Event]:
    """Return when the grasp force rose after each alarm that follows an alarm-free state."""
    found: list[Event] = []
    for row in starts(record.times, (record.grip == ContactState.SLIP).any(axis=1)):
        start = record.grasp_force[row - 1]
        soon = record.times[row:] <= record.times[row] + REACTION
        risen = np.flatnonzero(record.grasp_force[row:][soon] > (1.0 + RISE) * start)
        text = f"the grasp force rises above {start:.3g} N"
        found += _at(record, row + risen[:1], "reaction", "", text)
    return found
