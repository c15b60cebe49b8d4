# SPDX-License-Identifier: Apache-2.0
"""Desired poses: received from users, and published when they become the target."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped

from tactile_hand_ros import names
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.targets import MAX_WAITING
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec
from tactile_hand_ros.ros.node import TactileNode

DAY_NS = 86_400_000_000_000


def far_ahead(stamp: int, tick: int) -> str:
    """Return the error text for a timestamp more than a day ahead of a tick [ns]."""
    return (
        f"the stamp is {1e-9 * (stamp - tick):.0f} s ahead of the ticks, which are at "
        f"{1e-9 * tick:.3f} s; use the time of the ticks, or 0 for immediately."
    )


class DesiredPoses:
    """Subscribes to `desired_pose`, and publishes each pose again when it becomes the target.

    Attributes:
        fresh: Poses received since the last tick, with their timestamps [ns].
    """

    def __init__(
        self, node: TactileNode[Any], controller: Controller, last_tick: Callable[[], int | None]
    ) -> None:
        """Create both ends; `last_tick` returns the last tick [ns], or None before the first."""
        self._node, self._controller = node, controller
        self._last_tick = last_tick
        self._codec = PoseCodec(nan_allowed=True)
        self.fresh: deque[tuple[Target, int]] = deque(maxlen=MAX_WAITING)
        self._publisher = node.create_publisher(PoseStamped, names.ACCEPTED_POSE, qos.USER_DEPTH)
        node.subscribe(PoseStamped, names.DESIRED_POSE, self.take, profile=qos.USER_DEPTH, raw=True)

    def take(self, data: bytes) -> None:
        """Decode a pose and send it to the controller."""
        stamp, pose = self._codec.decode(data)
        target = Target.of(*pose)
        last = self._last_tick()
        if last is not None and stamp > last + DAY_NS:
            raise MessageError(far_ahead(stamp, last))
        dropped = self._controller.targets.dropped
        self._controller.targets.command(target, stamp)
        self.fresh.append((target, stamp))
        if self._controller.targets.dropped > dropped:
            text = f"more than {MAX_WAITING} poses wait for their tick; the earliest is dropped"
            self._node.reject(names.DESIRED_POSE, text)
            self._node.diagnostics.value("dropped_poses", self._controller.targets.dropped)

    def before(self, tick: int) -> None:
        """Reject poses of another clock that arrived before the first tick [ns]."""
        for stamp in self._controller.targets.forget_after(tick + DAY_NS):
            self._node.reject(names.DESIRED_POSE, far_ahead(stamp, tick))

    def after(self, tick: int) -> None:
        """Publish the pose that became the target at a tick [ns], if one did."""
        pose = self._controller.targets.accepted
        if pose is not None:
            self._publisher.publish(self._codec.encode(pose.position, pose.quaternion, tick))
        self.fresh.clear()

    def command_again(self) -> None:
        """Send the poses since the last tick to the controller again, after its reset."""
        for target, stamp in self.fresh:
            self._controller.targets.command(target, stamp)
