# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of a running hand, and how the terminal shows them."""

from __future__ import annotations

import contextlib
import math
import time
from typing import IO, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rich.console import Console
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.names import CONTROLLER, PLANT, REGULATOR
from tactile_hand_ros.ros.diagnostics import OK, STALE
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest, taken

_LINE_PERIOD = 2.0  # s between two lines


class Monitor:
    """The newest diagnostics of the nodes, decoded only on demand.

    A subscription to a topic of the tick costs its publisher one packet per tick: a tenth of the
    time of an in-process tick. A run is therefore followed by its diagnostics. They arrive once per
    second, and from the plant also at the first and the last answer.
    """

    def __init__(self, node: Node, *, closely: bool) -> None:
        """Subscribe outside the node's executor; `closely` follows every tick, to send commands."""
        self._node = node
        self._diagnostics = subscribe_directly(
            node, DiagnosticArray, names.DIAGNOSTICS, QoSProfile(depth=100)
        )
        self._commands = closely and subscribe_directly(
            node, JointState, names.JOINT_COMMAND, QoSProfile(depth=1)
        )
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
                self._status[status.name] = (status.level, status.message)
                self._facts[status.name] = {pair.key: pair.value for pair in status.values}
        return self._facts

    def of(self, node: str) -> dict[str, str]:
        """Return the values of the newest diagnostics of a node of this hand."""
        return self.facts().get(f"{self._node.get_namespace().rstrip('/')}/{node}", {})

    @property
    def is_at_rest(self) -> bool:
        """Whether the plant is paused or finished and its last tick was answered."""
        plant = self.of(PLANT)
        is_still = plant.get("mode") in ("paused", "finished")
        return is_still and self.answered() >= int(plant["tick_ns"])

    def in_words(self) -> str:
        """Return pose error and grasp force in words; no error unless the controller is driving."""
        controller, force = self.of(CONTROLLER), self.of(REGULATOR).get("grasp_force_n")
        mode, error = controller.get("mode", ""), float(controller.get("position_error_m", "nan"))
        if mode not in ("", "drive"):  # after a drop, for example, the last error is stale
            pose = f"not driving: {mode}"
        elif math.isnan(error):
            pose = "pose error unknown"
        else:
            pose = f"pose error {1e3 * error:.{3 if error < 0.01 else 1}f} mm"
        return f"{pose}  k_f " + ("-" if force is None else f"{float(force):.2f} N")


def line_console(file: IO[str], **options: Any) -> Console:
    """Return a console that prints text unchanged; ``soft_wrap`` keeps lines unfolded."""
    return Console(file=file, highlight=False, markup=False, **options)


class View:
    """Progress of a run: a line every `period` [s], and each new fault."""

    def __init__(self, console: Console, duration: float | None, *, quiet: bool) -> None:
        """Prepare; `duration` is the simulated time of the run [s], None for an endless run."""
        self._console, self._of = console, "" if duration is None else f" of {duration:g}"
        self._first: tuple[float, float] | None = None  # wall and simulated time, s
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
        facts = f"{monitor.in_words()}  {self._speed(at):.2f} x real time"
        self._console.print(f"t = {at:.2f}{self._of} s  {facts}", soft_wrap=True)

    def _speed(self, at: float) -> float:
        """Return simulated time per wall-clock time since the first tick or the last reset."""
        now = time.monotonic()
        if self._first is None or at <= self._first[1]:
            self._first = (now, at)
        return (at - self._first[1]) / max(now - self._first[0], 1e-9)
