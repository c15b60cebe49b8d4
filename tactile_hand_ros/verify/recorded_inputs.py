# SPDX-License-Identifier: Apache-2.0
"""Inputs and changes of the controllers of a recorded run, tick by tick."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.run.events import Asked, nanoseconds, read_asked
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario

Flags = NDArray[np.bool_]

_FIELDS = (
    *("", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value"),
    *("bool_array_value", "integer_array_value", "double_array_value", "string_array_value"),
)
"""Fields of rcl_interfaces/ParameterValue in the order of rcl_interfaces/ParameterType."""

CONTROLLERS = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)
PARAMETERS = "parameters"
OF_LAW = ("law.name", "law.folder")
"""Parameters of the controller that choose its law."""


class Change(NamedTuple):
    """A change of a controller: the first tick [ns] whose answer it could change, kind, value.

    `name` is `PARAMETERS`, the topic of a command, or the service or latched topic of a request.
    """

    stamp: int
    name: str
    value: Any


@dataclass(frozen=True)
class Inputs:
    """The sensor topics of a run, and all changes by users."""

    record: Record
    contacts: list[Contacts | None]  # of each tick, None without a message
    measured: Flags  # ticks with a force from every finger, shape (n,)
    changes: Mapping[str, Sequence[Change]]  # by node; the first is the initial configuration
    may_skip: bool = False  # whether a node may skip ticks, as in real time if it lags

    def answered(self, answers: Array) -> Flags:
        """Return which ticks a node did not skip, shape (n,), from its answers, shape (n, ...)."""
        given: Flags = np.asarray(np.isfinite(answers.reshape(len(answers), -1)).any(axis=1))
        return given if self.may_skip else np.ones(len(given), dtype=np.bool_)


def read_inputs(run: Run, scenario: Scenario, of_scenario: Collection[str] = ()) -> Inputs:
    """Collect the inputs of a run.

    The scenario is for controllers without a recorded configuration; parameters `of_scenario` are
    always taken from it. Raise ConfigurationError if a recorded configuration is invalid.
    """
    record = run.record
    series = run.series[run.topics.full(names.CONTACTS)]
    touched = np.isin(record.stamps, series.stamps)
    poses = zip(record.contact_positions, record.contact_quaternions, strict=True)
    contacts = [
        Contacts.from_poses(*pose) if known else None
        for pose, known in zip(poses, touched, strict=True)
    ]
    measured = np.asarray(np.isfinite(record.forces[:, :, 1]).all(axis=1))
    commands = {names.REGULATOR: _forces(run), names.OPTIMIZER: [], names.CONTROLLER: _poses(run)}
    changes = {}
    for node in CONTROLLERS:
        first, *later = _configurations(run, node, getattr(scenario, node), of_scenario)
        asked = read_asked(run.messages[run.topics.full(names.accepted_requests(node))])
        later += [Change(each.stamp, each.key, _value(each, record.finger_names)) for each in asked]
        later += commands[node]
        changes[node] = [first, *sorted(later, key=lambda change: change.stamp)]
    return Inputs(record, contacts, measured, changes, scenario.plant.pacing == "realtime")


def _value(asked: Asked, fingers: Sequence[str]) -> Any:
    if asked.key == names.TOUCH_REJECTED:
        return np.array(names.is_listed(fingers, asked.value))
    return asked.value == "true"


def _poses(run: Run) -> list[Change]:
    poses = _numbers(run, names.ACCEPTED_POSE, "pose", 7)
    return [Change(at, names.DESIRED_POSE, Target.of(pose[:3], pose[3:])) for at, pose in poses]


def _forces(run: Run) -> list[Change]:
    wrenches = _numbers(run, names.ACCEPTED_FORCE, "wrench", 6)
    return [Change(at, names.GRASP_FORCE, float(wrench[1])) for at, wrench in wrenches]


def _numbers(run: Run, topic: str, name: str, count: int) -> Iterator[tuple[int, Array]]:
    """Yield the tick [ns] and the numbers of each message of a topic."""
    series = run.series[run.topics.full(topic)]
    return zip(series.stamps.tolist(), series.rows(name, count), strict=True)


def _configurations(
    run: Run, node: str, config: Config, of_scenario: Collection[str]
) -> list[Change]:
    """Return the recorded configurations of a node, or the given one if there are none."""
    topic = run.topics.full(names.accepted_parameters(node))
    changes = []
    for event in (each.message for each in read_messages(run.bag, [topic])):
        recorded = {k: v for k, v in _values(event).items() if k not in of_scenario}
        changes.append(Change(nanoseconds(event.stamp), PARAMETERS, config.changed(recorded)))
    # A late subscriber also gets those of earlier runs, so log times do not separate the runs.
    stamps = [change.stamp for change in changes]
    resets = [i for i in range(1, len(stamps)) if stamps[i] < stamps[i - 1]]
    return changes[resets[-1] if resets else 0 :] or [Change(0, PARAMETERS, config)]


def _values(event: Any) -> dict[str, Any]:
    """Return the values of a ParameterEvent by name; the type selects the field.

    Raises:
        BagError: If a type is unknown.
    """
    for p in event.changed_parameters:
        if not 0 < p.value.type < len(_FIELDS):
            raise BagError(
                f"The recorded parameter '{p.name}' has the type {p.value.type}, expected 1 to "
                f"{len(_FIELDS) - 1}."
            )
    found = {p.name: getattr(p.value, _FIELDS[p.value.type]) for p in event.changed_parameters}
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found.items()}
