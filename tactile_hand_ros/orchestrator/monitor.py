# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of a hand: what a run waits for, how far it is, and how a terminal shows it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rich.console import Console
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.names import CONTROLLER, PLANT, REGULATOR
from tactile_hand_ros.ros.diagnostics import OK, STALE
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest, taken
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS

_LINE_PERIOD = 2.0  # s between two lines


class Monitor:
    """The newest diagnostics of the nodes of this hand, decoded only on demand.

    A subscription to a topic of the tick costs its publisher one packet per tick: a tenth of the
    time of an in-process tick. A run is therefore followed by its diagnostics. They arrive once per
    second, and from the plant also at the first and the last answer.
    """

    def __init__(self, node: Node, *, closely: bool) -> None:
        """Subscribe outside the node's executor; `closely` follows every tick, to send commands."""
        self._prefix = node.get_namespace().rstrip("/")
        self._diagnostics = subscribe_directly(node, DiagnosticArray, names.DIAGNOSTICS, 100)
        self._commands = closely and subscribe_directly(node, JointState, names.JOINT_COMMAND, 1)
        self._status: dict[str, tuple[bytes, str]] = {}
        self._facts: dict[str, dict[str, str]] = {}
        self.tick = -1

    def answered(self) -> int:
        """Return the newest tick known to be answered [ns], -1 before the first."""
        if not self._commands:
            self.tick = int(self.of(PLANT).get("answered_ns", -1))
        elif (data := take_latest(self._commands)) is not None:
            with contextlib.suppress(MessageError):  # the plant rejects and reports it
                self.tick = header_stamp(data)
        return self.tick

    def faults(self) -> list[str]:
        """Return a sentence for each node that reports a warning or an error."""
        self.facts()
        wrong = {n: text for n, (level, text) in self._status.items() if OK < level < STALE}
        return [f"{name}: {text}" for name, text in sorted(wrong.items())]

    def facts(self) -> dict[str, dict[str, str]]:
        """Return the values of the newest diagnostics, by full name of the node."""
        for data, _ in taken(self._diagnostics):
            for status in deserialize_message(data, DiagnosticArray).status:
                if status.name.rpartition("/")[0] == self._prefix:  # other hands share the topic
                    self._status[status.name] = (status.level, status.message)
                    self._facts[status.name] = {pair.key: pair.value for pair in status.values}
        return self._facts

    def of(self, node: str) -> dict[str, str]:
        """Return the values of the newest diagnostics of a node of this hand."""
        return self.facts().get(f"{self._prefix}/{node}", {})

    @property
    def is_at_rest(self) -> bool:
        """Whether the plant is paused or finished and its last tick was answered."""
        plant = self.of(PLANT)
        is_still = plant.get("mode") in ("paused", "finished")
        return is_still and self.answered() >= int(plant["tick_ns"])

    def in_words(self) -> str:
        """Return pose error and grasp force; no error unless the controller is driving."""
        controller, force = self.of(CONTROLLER), self.of(REGULATOR).get("grasp_force_n")
        mode, error = controller.get("mode", ""), float(controller.get("position_error_m", "nan"))
        if mode not in ("", "drive"):  # after a drop, for example, the last error is stale
            pose = f"not driving: {mode}"
        elif math.isnan(error):
            pose = "pose error unknown"
        else:
            pose = f"pose error {1e3 * error:.3f} mm"
        return f"{pose}  k_f " + ("-" if force is None else f"{float(force):.2f} N")


def missing_endpoints(
    node: Node, members: Sequence[str], facts: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[str, str]]:
    """Yield each missing endpoint: the name of a node, and a sentence.

    Existing endpoints are not enough: each publisher and subscription must have matched the other.
    Only the two nodes can see this, and report it in their diagnostics.

    Args:
        node: Any node in the namespace of the run.
        members: Names of the nodes. A recorder among them must receive every topic except user
            commands; omit one that shares a process with the publishers.
        facts: The values in the diagnostics of the nodes, by full name.
    """
    prefix = node.get_namespace().rstrip("/")
    reports = {name: facts.get(f"{prefix}/{name}") for name in members}
    yield from ((n, f"{n} does not report yet") for n, report in reports.items() if report is None)
    sent, received = _ends(reports, PUBLICATIONS), _ends(reports, SUBSCRIPTIONS)
    not_recorded = {f"{prefix}/{topic}" for topic in names.USER_COMMANDS}
    for topic, publishers in sent.items():
        subscribers = received.get(topic, {})
        if reports.get(names.RECORDER) is not None and topic not in not_recorded:
            subscribers.setdefault(names.RECORDER, 0)
        for name, count in subscribers.items():
            if not count:
                yield name, f"{name} does not receive {topic} yet"
        wanted = max(len(subscribers), node.count_subscribers(topic))
        for name, count in publishers.items():
            if count < wanted:
                yield name, f"{name} has matched {count} of {wanted} subscribers of {topic}"


def _ends(reports: Mapping[str, Mapping[str, str] | None], end: str) -> dict[str, dict[str, int]]:
    """Return the number of matched peers by topic and name of the node."""
    found: dict[str, dict[str, int]] = {}
    for name, values in reports.items():
        for key, count in (values or {}).items():
            kind, _, topic = key.partition(" ")
            is_hidden = f"/{names.HIDDEN}" in topic
            if kind == end and topic not in names.OF_ALL and not is_hidden:
                found.setdefault(topic, {})[name] = int(count)
    return found


def line_console(file: IO[str], **options: Any) -> Console:
    """Return a console that prints text unchanged; ``soft_wrap`` keeps lines unfolded."""
    return Console(file=file, highlight=False, markup=False, **options)


class View:
    """Progress of a run: a line every `period` [s], and each new fault; nothing if quiet."""

    def __init__(self, console: Console, duration: float | None, *, quiet: bool) -> None:
        """Prepare; `duration` is the simulated time of the run [s], None for an endless run."""
        self._console, self._of = console, "" if duration is None else f" of {duration:g}"
        self._fault = ""
        self.period = math.inf if quiet else _LINE_PERIOD

    def show(self, monitor: Monitor) -> None:
        """Show the progress of the run, and the first fault if it has changed."""
        if self.period == math.inf:
            return
        at = max(0.0, 1e-9 * monitor.tick)
        fault = next(iter(monitor.faults()), "")
        if fault and fault != self._fault:
            self._console.print(f"t = {at:.2f} s  ! {fault}", soft_wrap=True)
        self._fault = fault
        self._console.print(f"t = {at:.2f}{self._of} s  {monitor.in_words()}", soft_wrap=True)
