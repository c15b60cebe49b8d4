# SPDX-License-Identifier: Apache-2.0
"""What the orchestrator knows about a running hand, taken from the nodes' diagnostics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.names import CONTROLLER, PLANT, REGULATOR
from tactile_hand_ros.ros.diagnostics import OK, STALE
from tactile_hand_ros.ros.direct_take import subscribe_directly, take_latest, taken
from tactile_hand_ros.ros.messages import (
    Pose,
    PoseCodec,
)
from tactile_hand_ros.scenario.scenario import TargetConfig

_LATEST, _ALL = 1, 100


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
    tick takes in one process. So a recorded run is followed by its diagnostics alone, which come
    once a second, and from the plant also at the first answer and the last.
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
            with suppress(MessageError):  # the plant rejects it too, and reports it
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
        """Whether the plant stands still and its last tick was answered."""
        plant = self.plant_facts()
        stands = plant.get("mode") in ("paused", "finished")
        return stands and self.answered() >= int(plant["tick_ns"])
