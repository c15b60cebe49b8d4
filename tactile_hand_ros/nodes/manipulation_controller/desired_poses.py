# SPDX-License-Identifier: Apache-2.0
"""The desired poses that users send to the manipulation controller."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped

from tactile_hand_ros import names
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.targets import MOST_WAITING
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages.conversions import pose_from_ros, stamp_from_ns, stamp_to_ns
from tactile_hand_ros.ros.messages.wire import read_message
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks.inputs import DAY_NS, far_ahead


class _CommandedPose(Target):
    """A desired pose with its message: the rotation does not give back the exact quaternion."""

    message: PoseStamped


class DesiredPoses:
    """Subscribes to `desired_pose`, and publishes each pose again when it becomes the target."""

    def __init__(
        self,
        node: TactileNode[Any],
        controller: Controller,
        check_stamp: Callable[[int], None],
    ) -> None:
        """Create subscription and publisher.

        Args:
            node: The node.
            controller: Takes the poses.
            check_stamp: Raises `MessageError` if a stamp [ns] is of another clock than the ticks.
        """
        self._node, self._controller = node, controller
        self._check_stamp = check_stamp
        self._fresh: deque[tuple[Target, int]] = deque(maxlen=MOST_WAITING)
        self._publisher = node.create_publisher(PoseStamped, names.ACCEPTED_POSE, qos.user_qos())
        node.subscribe(PoseStamped, names.DESIRED_POSE, self.take, profile=qos.user_qos(), raw=True)

    @property
    def fresh(self) -> list[int]:
        """Stamps [ns] of the poses that came since the last tick."""
        return [stamp for _, stamp in self._fresh]

    def take(self, data: bytes) -> None:
        """Take a serialized pose."""
        message = read_message(data, PoseStamped)
        target, stamp = _CommandedPose(*pose_from_ros(message)), stamp_to_ns(message.header.stamp)
        self._check_stamp(stamp)
        target.message = message
        dropped = self._controller.dropped
        self._controller.command(target, stamp)
        self._fresh.append((target, stamp))
        if self._controller.dropped > dropped:
            text = f"more than {MOST_WAITING} poses wait for their tick, the earliest is dropped"
            self._node.reject(names.DESIRED_POSE, text)
            self._node.diagnostics.value("dropped_poses", self._controller.dropped)

    def before(self, tick: int) -> None:
        """Refuse poses of another clock that came when the time of the ticks was not known yet."""
        if not self._fresh:
            return
        for stamp in self._controller.forget_after(tick + DAY_NS):
            self._node.reject(names.DESIRED_POSE, far_ahead(stamp, tick))

    def after(self, tick: int) -> None:
        """Publish the pose that became the target at a tick [ns], if one did."""
        pose = self._controller.accepted
        if pose is not None:
            assert isinstance(pose, _CommandedPose)
            pose.message.header.stamp = stamp_from_ns(tick)
            self._publisher.publish(pose.message)
        self._fresh.clear()

    def forget(self) -> None:
        """Forget what came since the last tick."""
        self._fresh.clear()

    def command_again(self) -> None:
        """Give the controller, which has forgotten them, the poses since the last tick again."""
        for target, stamp in self._fresh:
            self._controller.command(target, stamp)
