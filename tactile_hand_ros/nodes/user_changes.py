# SPDX-License-Identifier: Apache-2.0
"""What users send, and what became of it, published with the tick that it changes.

A command, a service call or a parameter arrives between two ticks, and only the node can
say between which. It therefore publishes each of them once more, stamped with the first
tick whose answer it can change. A recording of these topics is enough to repeat what the node did.
A command that it rejects is answered with the reason and the last tick that was answered before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterEvent
from rclpy.publisher import Publisher

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.targets import MOST_WAITING
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import (
    PoseCodec,
    stamp_from_ns,
)
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.parameters import to_parameters
from tactile_hand_ros.rotations import rotation_from_quaternion

Array = NDArray[np.float64]

_REJECTION_LIMIT = 10
"""Maximum number of rejections published between two ticks."""

MessageAt = Callable[[int], Any]
"""Makes a message, or its bytes, for a tick [ns]."""


class AppliedChanges:
    """Publishes accepted changes at the first tick that they can change.

    Publications: `accepted/<node>/parameters` (rcl_interfaces/ParameterEvent: the whole
    configuration in force; at the first tick, when ticks start again and after each change;
    transient local); where services or latched topics change the node, `accepted/<node>/requests`
    (diagnostic_msgs/DiagnosticArray: one key, the service or topic, with `true`, `false` or
    nothing); where users command it, `rejected/<node>` (diagnostic_msgs/DiagnosticArray: the topic
    of a rejected command and why).
    """

    def __init__(
        self,
        node: TactileNode[Any],
        name: str,
        *,
        requests: bool = False,
        commands: bool = False,
    ) -> None:
        """Create the publishers.

        Args:
            node: The node.
            name: Its name in topics, one of those in `names`.
            requests: Whether services or latched topics change what the node does.
            commands: Whether users command it.
        """
        self._name, self._full_name = name, node.get_fully_qualified_name()
        self._waiting: list[tuple[Publisher, MessageAt]] = []
        self._parameters = node.create_publisher(
            ParameterEvent, names.accepted_parameters(name), qos.configuration_qos()
        )
        if requests:
            self._requests = node.create_publisher(
                DiagnosticArray, names.accepted_requests(name), qos.user_qos()
            )
        if commands:
            self._rejected = node.create_publisher(
                DiagnosticArray, names.rejected(name), qos.user_qos()
            )
        self._answered, self._rejections = 0, 0

    def begin(self, config: Config) -> None:
        """Start with the ticks: forget what has not taken effect, and publish the configuration."""
        self._waiting.clear()
        self.configuration(config)

    def configuration(self, config: Config) -> None:
        """Note that another configuration is in force."""
        event = ParameterEvent(node=self._full_name, changed_parameters=to_parameters(config))

        def message_at(stamp_ns: int) -> ParameterEvent:
            event.stamp = stamp_from_ns(stamp_ns)
            return event

        self.add(self._parameters, message_at)

    def request(self, service: str, value: bool | None = None) -> None:
        """Note that a service was called, or a latched topic has changed, with its value."""
        pair = KeyValue(key=service, value="" if value is None else str(value).lower())
        status = DiagnosticStatus(name=self._name, message=service, values=[pair])

        def message_at(stamp_ns: int) -> DiagnosticArray:
            message = DiagnosticArray(status=[status])
            message.header.stamp = stamp_from_ns(stamp_ns)
            return message

        self.add(self._requests, message_at)

    def rejected(self, topic: str, reason: str) -> None:
        """Publish immediately that a command of the user was rejected.

        Args:
            topic: The command, a relative topic.
            reason: Why, in one line.
        """
        self._rejections += 1
        if topic in names.USER_COMMANDS and self._rejections <= _REJECTION_LIMIT:
            pair = KeyValue(key=topic, value=reason)
            status = DiagnosticStatus(
                level=DiagnosticStatus.WARN, name=self._name, message=reason, values=[pair]
            )
            message = DiagnosticArray(status=[status])
            message.header.stamp = stamp_from_ns(self._answered)
            self._rejected.publish(message)

    def add(self, publisher: Publisher, message_at: MessageAt) -> None:
        """Note something else that takes effect at the next tick."""
        self._waiting.append((publisher, message_at))

    def take_effect(self, stamp_ns: int) -> None:
        """Publish what was accepted since the last tick; call it after each answer.

        Args:
            stamp_ns: The tick that was answered [ns].
        """
        self._answered, self._rejections = stamp_ns, 0
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            for publisher, message_at in waiting:
                publisher.publish(message_at(stamp_ns))


DAY_NS = 86_400_000_000_000


def far_ahead(stamp: int, tick: int) -> str:
    """Return what is wrong with a stamp that is more than a day ahead of a tick [ns]."""
    return (
        f"the stamp is {1e-9 * (stamp - tick):.0f} s ahead of the ticks, which are at "
        f"{1e-9 * tick:.3f} s; use their time, or 0 for immediately."
    )


class _CommandedPose(Target):
    """A desired pose as it came: the rotation does not give back the exact quaternion."""

    quaternion: Array


class DesiredPoses:
    """Subscribes to `desired_pose`, and publishes each pose again when it becomes the target."""

    def __init__(
        self,
        node: TactileNode[Any],
        controller: Controller,
        last_tick: Callable[[], int | None],
    ) -> None:
        """Create subscription and publisher.

        Args:
            node: The node.
            controller: Takes the poses.
            last_tick: Returns the last tick [ns]; None before the first.
        """
        self._node, self._controller = node, controller
        self._last_tick = last_tick
        self._codec = PoseCodec()
        self._fresh: deque[tuple[Target, int]] = deque(maxlen=MOST_WAITING)
        self._publisher = node.create_publisher(PoseStamped, names.ACCEPTED_POSE, qos.user_qos())
        node.subscribe(PoseStamped, names.DESIRED_POSE, self.take, profile=qos.user_qos(), raw=True)

    @property
    def fresh(self) -> list[int]:
        """Stamps [ns] of the poses that came since the last tick."""
        return [stamp for _, stamp in self._fresh]

    def take(self, data: bytes) -> None:
        """Take a serialized pose."""
        stamp, pose = self._codec.decode(data)
        target = _CommandedPose(pose.position, rotation_from_quaternion(pose.quaternion))
        last = self._last_tick()
        if last is not None and stamp > last + DAY_NS:
            raise MessageError(far_ahead(stamp, last))
        target.quaternion = pose.quaternion
        dropped = self._controller.dropped
        self._controller.command(target, stamp)
        self._fresh.append((target, stamp))
        if self._controller.dropped > dropped:
            text = f"more than {MOST_WAITING} poses wait for their tick, the earliest is dropped"
            self._node.reject(names.DESIRED_POSE, text)
            self._node.diagnostics.value("dropped_poses", self._controller.dropped)

    def before(self, tick: int) -> None:
        """Reject poses of another clock that came when the time of the ticks was not known yet."""
        if not self._fresh:
            return
        for stamp in self._controller.forget_after(tick + DAY_NS):
            self._node.reject(names.DESIRED_POSE, far_ahead(stamp, tick))

    def after(self, tick: int) -> None:
        """Publish the pose that became the target at a tick [ns], if one did."""
        pose = self._controller.accepted
        if pose is not None:
            assert isinstance(pose, _CommandedPose)
            self._publisher.publish(self._codec.encode(pose.position, pose.quaternion, tick))
        self._fresh.clear()

    def forget(self) -> None:
        """Forget what came since the last tick."""
        self._fresh.clear()

    def command_again(self) -> None:
        """Give the controller, which has forgotten them, the poses since the last tick again."""
        for target, stamp in self._fresh:
            self._controller.command(target, stamp)
