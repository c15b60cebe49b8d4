# SPDX-License-Identifier: Apache-2.0
"""The inputs of the controllers of a recorded run, tick by tick, and what changed them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.model import Config, flatten
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.run.events import read_asked
from tactile_hand_ros.run.reading import Series, in_last_run, last_reset
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_FIELDS = (
    *("", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value"),
    *("bool_array_value", "integer_array_value", "double_array_value", "string_array_value"),
)
"""Of rcl_interfaces/ParameterValue, in the order of rcl_interfaces/ParameterType."""

CONTROLLERS = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)


class Effect(NamedTuple):
    """Something that took effect at a tick.

    Attributes:
        stamp: The first tick whose answer it could change, ns.
        value: A `Target`, a squeeze in N, a `ServiceCall` or a configuration.
    """

    stamp: int
    value: Any


class ServiceCall(NamedTuple):
    """A service call or a latched topic, such as whether the joints are held, with its value."""

    service: str
    value: bool


class Effects:
    """Gives the effects of a run when their tick comes."""

    def __init__(self, effects: Sequence[Effect]) -> None:
        """Take effects in the order of their ticks."""
        self._waiting = deque(effects)

    def first(self) -> Any:
        """Return the value of the first effect, whatever its tick."""
        return self._waiting.popleft().value

    def until(self, stamp: int) -> Iterator[Any]:
        """Yield the values that took effect at or before a tick [ns], each of them once."""
        while self._waiting and self._waiting[0].stamp <= stamp:
            yield self._waiting.popleft().value


@dataclass(frozen=True)
class Inputs:
    """The sensor topics of a run, and everything that users changed.

    Attributes:
        record: All arrays, NaN where there is no message.
        contacts: Contacts of each tick, None where no message has come.
        felt: Ticks with a force of every finger, shape (n,).
        configurations: Configurations of each controller; the first is in force from the start.
        poses: Desired poses.
        forces: Requested squeezes.
        requests: Service calls, by node.
        may_skip: Whether a node may have skipped ticks, as in real time when it falls behind.
    """

    record: Record
    contacts: list[Contacts | None]
    felt: Flags
    configurations: Mapping[str, Sequence[Effect]]
    poses: Sequence[Effect] = ()
    forces: Sequence[Effect] = ()
    requests: Mapping[str, Sequence[Effect]] = field(default_factory=dict)
    may_skip: bool = False

    def answered(self, answers: Array) -> Flags:
        """Return which ticks a node has not skipped, shape (n,).

        Args:
            answers: Its answer at each tick, NaN where there is none, shape (n, ...).
        """
        given: Flags = np.asarray(np.isfinite(answers.reshape(len(answers), -1)).any(axis=1))
        return given if self.may_skip else np.ones(len(given), dtype=np.bool_)

    def changed(self, base: Scenario, wanted: Scenario) -> Inputs:
        """Return these inputs with the configurations changed as one scenario is from another."""
        configurations = {}
        for node, effects in self.configurations.items():
            before = flatten(base.node_config(node))
            after = flatten(wanted.node_config(node))
            changes = {name: value for name, value in after.items() if value != before[name]}
            configurations[node] = [
                Effect(stamp, config.changed(changes)) for stamp, config in effects
            ]
        return replace(self, configurations=configurations)


def configured(scenario: Scenario) -> dict[str, list[Effect]]:
    """Return the configurations of the controllers of a scenario, without any live change."""
    return {node: [Effect(0, scenario.node_config(node))] for node in CONTROLLERS}


def read_inputs(run: Run, scenario: Scenario) -> Inputs:
    """Collect the inputs of a run.

    Args:
        run: The run.
        scenario: Its scenario, for controllers of which the bag does not hold the configuration.

    Raises:
        BagError: If the bag cannot be read.
        ConfigurationError: If a recorded configuration is not valid.
    """
    record = run.record
    series = run.series[run.topics.full(names.CONTACTS)]
    touched = np.isin(record.stamps, series.stamps)
    poses = zip(record.contact_positions, record.contact_quaternions, strict=True)
    contacts = [
        Contacts.from_poses(*pose) if known else None
        for pose, known in zip(poses, touched, strict=True)
    ]
    felt = np.asarray(np.isfinite(record.forces).all(axis=(1, 2)))
    return Inputs(
        record,
        contacts,
        felt,
        {node: _configurations(run, node, scenario.node_config(node)) for node in CONTROLLERS},
        _poses(run),
        _forces(run),
        {node: _requests(run, node) for node in CONTROLLERS},
        may_skip=scenario.plant.pacing == "realtime",
    )


def _poses(run: Run) -> list[Effect]:
    series, counts = _of_last_run(run, names.ACCEPTED_POSE)
    poses = series.rows("pose", 7)
    return [
        Effect(int(series.stamps[row]), Target(poses[row, :3], rotation_from_quaternion(turn)))
        for row, turn in zip(np.flatnonzero(counts), poses[counts, 3:], strict=True)
    ]


def _forces(run: Run) -> list[Effect]:
    series, counts = _of_last_run(run, names.ACCEPTED_FORCE)
    squeezes = series.rows("wrench", 6)[counts, 1]
    pairs = zip(series.stamps[counts].tolist(), squeezes.tolist(), strict=True)
    return [Effect(*pair) for pair in pairs]


def _of_last_run(run: Run, name: str) -> tuple[Series, Flags]:
    """Return a topic and which of its messages belong to the last run in the bag."""
    series = run.series[run.topics.full(name)]
    return series, in_last_run(series, run.series[run.topics.full(names.JOINT_STATES)])


def _configurations(run: Run, node: str, config: Config) -> list[Effect]:
    """Return the configurations of a node, or the given one where the bag has none."""
    topic = run.topics.full(names.accepted_parameters(node))
    effects = [
        Effect(_ns(event.stamp), config.changed(_values(event)))
        for _, _, event in read_messages(run.bag, [topic])
    ]
    # A late subscriber gets the last ones of earlier runs too, so log times do not separate them.
    stamps = np.array([effect.stamp for effect in effects], dtype=np.int64)
    return effects[last_reset(stamps) :] or [Effect(0, config)]


def _values(event: Any) -> dict[str, Any]:
    """Return the values in a ParameterEvent by name."""
    return {each.name: _value(each.value) for each in event.changed_parameters}


def _value(value: Any) -> Any:
    """Return a ParameterValue as a plain value; its type says which of its fields counts."""
    found = getattr(value, _FIELDS[value.type])
    return found.tolist() if isinstance(found, np.ndarray) else found


def _requests(run: Run, node: str) -> list[Effect]:
    topic = run.topics.full(names.accepted_requests(node))
    states = run.series[run.topics.full(names.JOINT_STATES)]
    found = read_asked(run.messages[topic], states)
    return [Effect(each.stamp, ServiceCall(each.key, each.value == "true")) for each in found]


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
