# SPDX-License-Identifier: Apache-2.0
"""Looks at a running hand without slowing it down: the newest messages, taken when asked for."""

from __future__ import annotations

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
from tactile_hand_ros.ros.messages.conversions import pose_from_ros, stamp_to_ns

_LATEST, _ALL = 1, 100


@dataclass(frozen=True)
class Look:
    """What a look at the hand shows; NaN where nothing was heard.

    Attributes:
        time: Simulated time [s].
        position_error: Distance of the contact centroid from its desired position [m].
        grasp_force: k_f [N].
    """

    time: float
    position_error: float
    grasp_force: float


class Monitor:
    """Subscriptions that hold one message each and decode it only on demand.

    A subscription to a topic of the tick costs its publisher a packet a tick: a tenth of what a
    tick takes in one process. So there is none, and all that is known is what the nodes say of
    themselves once a second, and the plant also at the first answer and the last.
    """

    def __init__(self, node: Node, *, closely: bool = False) -> None:
        """Subscribe.

        Args:
            node: A node in the namespace of the run. Its executor does not see the subscriptions.
            closely: Whether to follow time and the distance to the target at each tick. A run needs
                it that is not recorded, or in which the user does something at a given time.
        """
        self._node = node
        self._closely = closely
        if closely:
            self._command = self._subscribe(JointState, names.JOINT_COMMAND, _LATEST)
            self._pose = self._subscribe(PoseStamped, names.AUXILIARY_POSE, _LATEST)
            self._desired = self._subscribe(PoseStamped, names.ACCEPTED_POSE, _ALL)
        self._diagnostics = self._subscribe(DiagnosticArray, names.DIAGNOSTICS, _ALL)
        self._last: dict[str, Any] = {}
        self._targets: list[tuple[int, Any]] = []
        self._status: dict[str, tuple[bytes, str]] = {}
        self._facts: dict[str, dict[str, str]] = {}
        self._namespace = node.get_namespace().rstrip("/")
        self.tick = -1

    def _subscribe(self, kind: Any, topic: str, depth: int) -> Subscription:
        return subscribe_directly(self._node, kind, topic, QoSProfile(depth=depth))

    def answered(self) -> int:
        """Return the newest tick that is known to be answered [ns], -1 before the first."""
        if not self._closely:
            self.tick = int(self.plant_facts().get("answered_ns", -1))
        elif (data := take_latest(self._command)) is not None:
            before = self.tick
            with suppress(MessageError):  # the plant refuses it too, and says so
                self.tick = header_stamp(data)
            if self.tick < before:
                self._targets.clear()  # a reset forgets them
        return self.tick

    def look(self) -> Look:
        """Return what is known now."""
        said = self._said(CONTROLLER, "position_error_m")
        return Look(
            time=max(0.0, 1e-9 * self.answered()),
            position_error=self._distance() if self._closely else said,
            grasp_force=self._said(REGULATOR, "grasp_force_n"),
        )

    def _distance(self) -> float:
        """Return the distance to the target at the newest pose [m]."""
        self._take_targets()
        pose = self._newest(self._pose, PoseStamped)
        return float(np.nan) if pose is None else self._error(pose)

    def _said(self, node: str, key: str) -> float:
        """Return a number in the newest diagnostics of a node."""
        return float(self._facts_of(node).get(key, "nan"))

    def _facts_of(self, node: str) -> dict[str, str]:
        return self.facts().get(f"{self._namespace}/{node}", {})

    def faults(self) -> list[str]:
        """Return a sentence for each node that reports a warning or an error."""
        self._take_diagnostics()
        wrong = {name: text for name, (level, text) in self._status.items() if _is_bad(level)}
        return [f"{name}: {text}" for name, text in sorted(wrong.items())]

    def facts(self) -> dict[str, dict[str, str]]:
        """Return the values in the newest diagnostics, by full name of the node."""
        self._take_diagnostics()
        return self._facts

    def plant_facts(self) -> dict[str, str]:
        """Return the values in the plant's newest diagnostics."""
        return self._facts_of(PLANT)

    @property
    def is_at_rest(self) -> bool:
        """Whether the plant stands still and its last tick was answered."""
        plant = self.plant_facts()
        stands = plant.get("mode") in ("paused", "finished")
        return stands and self.answered() >= int(plant["tick_ns"])

    def _take_diagnostics(self) -> None:
        for data, _ in taken(self._diagnostics):
            for status in deserialize_message(data, DiagnosticArray).status:
                self._status[status.name] = (status.level, status.message)
                self._facts[status.name] = {pair.key: pair.value for pair in status.values}

    def _newest(self, subscription: Subscription, kind: Any) -> Any:
        data = take_latest(subscription)
        if data is not None:
            self._last[subscription.topic_name] = deserialize_message(data, kind)
        return self._last.get(subscription.topic_name)

    def _take_targets(self) -> None:
        for data, _ in taken(self._desired):
            message = deserialize_message(data, PoseStamped)
            stamp = stamp_to_ns(message.header.stamp)
            if self._targets and stamp < self._targets[-1][0]:
                self._targets.clear()  # a reset has set time back
            self._targets.append((stamp, pose_from_ros(message).position))

    def _error(self, pose: PoseStamped) -> float:
        """Return the distance from the target that holds at the pose's tick [m]."""
        stamp = stamp_to_ns(pose.header.stamp)
        due = [index for index, (since, _) in enumerate(self._targets) if since <= stamp]
        if not due:
            return float(np.nan)
        self._targets = self._targets[due[-1] :]  # a later command replaces those before it
        point = pose.pose.position
        present = np.array((point.x, point.y, point.z))
        return float(np.linalg.norm(present - self._targets[0][1]))


def _is_bad(level: bytes) -> bool:
    return bool(OK < level < STALE)
