# SPDX-License-Identifier: Apache-2.0
"""Parts shared by several nodes: a log of modes, an encoder of poses, publishers of touch."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseArray

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.ros.messages import ContactsCodec, PoseCodec, WrenchPublishers
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.rotations import quaternion_from_rotation

_MAXIMUM = 5
"""Maximum number of lines per second; further changes are not logged."""


class ModeLog:
    """Logs mode changes immediately, at a limited rate."""

    def __init__(
        self, log: Callable[[str], Any], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start without a mode; `log` takes a line, `clock` is in seconds."""
        self._log, self._clock = log, clock
        self._mode, self._second, self._lines = "", -1, 0

    def note(self, mode: str, reason: str = "") -> None:
        """Log the mode and its reason if it has changed; of the first mode, only with a reason."""
        if mode == self._mode:
            return
        before, self._mode = self._mode, mode
        if not (before or reason):
            return
        second = int(self._clock())
        if second != self._second:
            self._second, self._lines = second, 0
        self._lines += 1
        if self._lines <= _MAXIMUM:
            change = f"{before} -> {mode}" if before else mode
            self._log(f"{change}: {reason}" if reason else change)


def rotated_pose_encoder() -> Callable[[Array, Array, int], bytes]:
    """Return an encoder of a position, a rotation matrix and a stamp [ns] as a pose."""
    encode = PoseCodec().encode
    return lambda position, rotation, stamp: encode(
        position, quaternion_from_rotation(rotation), stamp
    )


class ReadingPublisher:
    """Publishes contacts and forces: one PoseArray, and one WrenchStamped per finger."""

    def __init__(
        self,
        node: TactileNode[Any],
        fingers: Sequence[str],
        contacts_topic: str,
        wrench_topic: Callable[[str], str],
    ) -> None:
        """Create the publishers; `wrench_topic` maps a finger's name to the topic of its force."""
        encode = ContactsCodec(len(fingers)).encode
        self._contacts = node.tick_publisher(PoseArray, contacts_topic, encode)
        self._wrenches = WrenchPublishers(node, fingers, wrench_topic, normal_allowed=True)

    def publish(self, stamp_ns: int, positions: Array, quaternions: Array, forces: Array) -> None:
        """Publish the reading of a tick [ns]; see `TactileReading`."""
        self._contacts.publish(positions, quaternions, stamp_ns)
        self._wrenches.publish(stamp_ns, forces)
