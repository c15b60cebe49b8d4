# SPDX-License-Identifier: Apache-2.0
"""What a running hand reports, and how the terminal shows it."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rich.progress
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rich.console import Console
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.names import CONTROLLER, PLANT, REGULATOR
from tactile_hand_ros.ros.diagnostics import OK, STALE
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest, taken
from tactile_hand_ros.ros.messages import Pose, PoseCodec
from tactile_hand_ros.scenario.scenario import TargetConfig

_LATEST, _ALL = 1, 100
_BAR_PERIOD = 0.1  # s between two updates of the bar
_LINE_PERIOD = 2.0  # s between two plain lines


@dataclass(frozen=True)
class Progress:
    """How far a run is; NaN where nothing was received.

    Attributes:
        time: Simulated time [s].
        position_error: Distance of the contact centroid from its target [m].
        grasp_force: k_f [N].
        mode: What the controller does: drive, hold, open or disabled; empty if unknown.
    """

    time: float
    position_error: float
    grasp_force: float
    mode: str = ""


class Monitor:
    """Subscriptions that hold the newest messages and decode them only on demand.

    A subscription to a topic of the tick costs its publisher a packet a tick: a tenth of what a
    tick takes in one process. A recorded run is therefore followed by its diagnostics alone, which
    come once a second, and from the plant also at the first answer and the last.
    """

    def __init__(self, node: Node, targets: Sequence[TargetConfig], *, closely: bool) -> None:
        """Subscribe.

        Args:
            node: A node in the namespace of the run. Its executor does not see the subscriptions.
            targets: Of the scenario.
            closely: Whether to follow each tick. A run needs it that is not recorded, or in which
                something is sent at a given time.
        """
        self._node, self._closely = node, closely
        self._targets = targets
        if closely:
            self._command = self._subscribe(JointState, names.JOINT_COMMAND, _LATEST)
            self._pose = self._subscribe(PoseStamped, names.AUXILIARY_POSE, _LATEST)
        self._diagnostics = self._subscribe(DiagnosticArray, names.DIAGNOSTICS, _ALL)
        self._newest: tuple[int, Pose] | None = None
        self._codec = PoseCodec()
        self._status: dict[str, tuple[bytes, str]] = {}
        self._facts: dict[str, dict[str, str]] = {}
        self.tick = -1

    def _subscribe(self, kind: Any, topic: str, depth: int) -> Subscription:
        return subscribe_directly(self._node, kind, topic, QoSProfile(depth=depth))

    def answered(self) -> int:
        """Return the newest tick that is known to be answered [ns], -1 before the first."""
        if not self._closely:
            self.tick = int(self.plant_facts().get("answered_ns", -1))
        elif (data := take_latest(self._command)) is not None:
            with contextlib.suppress(MessageError):  # the plant rejects it too, and reports it
                self.tick = header_stamp(data)
        return self.tick

    def progress(self) -> Progress:
        """Return what is known now."""
        controller = self._facts_of(CONTROLLER)
        reported = float(controller.get("position_error_m", "nan"))
        return Progress(
            time=max(0.0, 1e-9 * self.answered()),
            position_error=self._distance() if self._closely else reported,
            grasp_force=float(self._facts_of(REGULATOR).get("grasp_force_n", "nan")),
            mode=controller.get("mode", ""),
        )

    def _distance(self) -> float:
        """Return the distance of the newest pose from the scenario's target at that tick [m]."""
        data = take_latest(self._pose)
        if data is not None:
            self._newest = self._codec.decode(data)
        if self._newest is None:
            return math.nan
        stamp, pose = self._newest
        due = [target for target in self._targets if target.stamp <= stamp]
        if not due:
            return math.nan
        target = max(due, key=lambda each: each.stamp)
        return float(np.linalg.norm(pose.position - target.position))

    def faults(self) -> list[str]:
        """Return a sentence for each node that reports a warning or an error."""
        self.facts()
        wrong = {n: text for n, (level, text) in self._status.items() if OK < level < STALE}
        return [f"{name}: {text}" for name, text in sorted(wrong.items())]

    def facts(self) -> dict[str, dict[str, str]]:
        """Return the values in the newest diagnostics, by full name of the node."""
        for data, _ in taken(self._diagnostics):
            for status in deserialize_message(data, DiagnosticArray).status:
                self._status[status.name] = (status.level, status.message)
                self._facts[status.name] = {pair.key: pair.value for pair in status.values}
        return self._facts

    def plant_facts(self) -> dict[str, str]:
        """Return the values in the plant's newest diagnostics."""
        return self._facts_of(PLANT)

    def _facts_of(self, node: str) -> dict[str, str]:
        return self.facts().get(f"{self._node.get_namespace().rstrip('/')}/{node}", {})

    @property
    def is_at_rest(self) -> bool:
        """Whether the plant is paused or finished and its last tick was answered."""
        plant = self.plant_facts()
        is_still = plant.get("mode") in ("paused", "finished")
        return is_still and self.answered() >= int(plant["tick_ns"])


class View:
    """Shows how far a run is."""

    def __init__(self, console: Console, duration: float | None, *, quiet: bool) -> None:
        """Prepare.

        Args:
            console: Where to write.
            duration: Simulated time of the run [s], None for an endless run.
            quiet: Whether to write nothing.
        """
        self._console, self._duration = console, duration
        self._fault = ""
        self._bar: rich.progress.Progress | None = None
        self.period = math.inf if quiet else _LINE_PERIOD
        if not quiet and console.is_terminal and not console.is_dumb_terminal:
            self.period = _BAR_PERIOD
            self._bar = rich.progress.Progress(
                rich.progress.TextColumn("{task.description}"),
                rich.progress.BarColumn(bar_width=None),
                rich.progress.TextColumn("{task.fields[facts]}"),
                console=console,
                auto_refresh=False,  # drawn by this thread, no other one takes its time
                transient=True,
            )
            self._task = self._bar.add_task("", total=duration, facts="")

    @contextlib.contextmanager
    def shown(self) -> Iterator[None]:
        """Show the progress for the duration of the block."""
        with self._bar or contextlib.nullcontext():
            yield

    def show(self, progress: Progress, rate: float, fault: str) -> None:
        """Show progress, ticks per second and the first fault, empty if there is none."""
        if self.period == math.inf:
            return
        if self._bar is None:
            of = "" if self._duration is None else f" of {self._duration:g}"
            tail = f"  ! {fault}" if fault else ""
            self._print(f"t = {progress.time:.2f}{of} s  {facts(progress, rate)}{tail}")
            return
        of = "" if self._duration is None else f" / {self._duration:g}"
        if fault and fault != self._fault:
            self._print(f"t = {progress.time:.2f} s  ! {fault}")  # in full, above the bar
        self._fault = fault
        self._bar.update(
            self._task,
            completed=progress.time,
            description=f"{progress.time:6.2f}{of} s",
            facts=facts(progress, rate),
            refresh=True,
        )

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def facts(progress: Progress, rate: float) -> str:
    """Return pose error, grasp force and rate in words; no error where nothing is driven."""
    force = "-" if math.isnan(progress.grasp_force) else f"{progress.grasp_force:.2f} N"
    return f"{_pose(progress)}  k_f {force}  {rate:.0f} ticks/s"


def _pose(progress: Progress) -> str:
    if progress.mode not in ("", "drive"):  # after a drop, for example, the last error is stale
        return f"not driving: {progress.mode}"
    error = progress.position_error
    if math.isnan(error):
        return "pose error unknown"
    return "pose error " + (f"{1e3 * error:.3f} mm" if error < 0.01 else f"{1e3 * error:.1f} mm")


class Rate:
    """Ticks per second of wall-clock time between the last two stamps that differ."""

    def __init__(self, tick: int) -> None:
        """Take the length of a tick [ns]."""
        self._tick = tick
        self._stamp: int | None = None
        self._time = self._rate = 0.0

    def __call__(self, stamp: int) -> float:
        """Return the rate at a stamp [ns], 0 before the second."""
        now = time.monotonic()
        before, since = self._stamp, now - self._time
        if stamp == before:
            return self._rate
        self._stamp, self._time = stamp, now
        if before is not None and stamp > before and since > 0.0:  # a reset sets time back
            self._rate = (stamp - before) / self._tick / since
        return self._rate
