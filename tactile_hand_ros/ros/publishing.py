# SPDX-License-Identifier: Apache-2.0
"""Publishers of what carries a tick: encoded once, and only if it has a subscriber or a tap."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from tactile_hand_ros.ros import qos

LOOK_PERIOD = 0.1
"""Time between two looks for subscribers [s]."""


class TickPublisher:
    """Encodes and publishes messages while there is a subscriber or a tap.

    A tap is called in the publisher's process with the same bytes, so a recorder there needs no
    subscription.

    Attributes:
        node: The node that publishes.
        kind: Message class.
        topic: Full name of the topic.
        qos_profile: Quality of service that it offers.
    """

    def __init__(self, node: Node, kind: Any, topic: str) -> None:
        """Create the publisher.

        Args:
            node: The node that publishes.
            kind: Message class.
            topic: Relative name of the topic.
        """
        self._publisher = node.create_publisher(kind, topic, qos.tick_publisher_qos())
        self.node, self.kind = node, kind
        self.topic: str = self._publisher.topic_name
        self.qos_profile: QoSProfile = self._publisher.qos_profile
        self._taps: list[Callable[[bytes], None]] = []
        self._is_read, self._next_look = False, 0.0
        self._last: tuple[Callable[..., bytes], tuple[Any, ...]] | None = None

    def add_tap(self, tap: Callable[[bytes], None]) -> None:
        """Call back with each message from now on, before it is sent."""
        self._taps.append(tap)

    @property
    def wanted(self) -> bool:
        """Whether there is a tap or a subscriber; a new subscriber is found within 0.1 s."""
        now = time.monotonic()
        if now >= self._next_look:
            self._next_look = now + LOOK_PERIOD
            self.get_subscription_count()
        return self._is_read or bool(self._taps)

    def get_subscription_count(self) -> int:
        """Return the number of matching subscriptions now."""
        count = int(self._publisher.get_subscription_count())
        self._is_read = count > 0
        return count

    def publish(self, encode: Callable[..., bytes], *values: Any) -> None:
        """Publish what `encode(*values)` returns; it is not called without a subscriber or tap."""
        self._last = encode, values
        if self.wanted:
            self._send(encode(*values))

    def repeat(self) -> None:
        """Publish the last message again, also to those that came after it."""
        if self._last is not None:
            encode, values = self._last
            self.publish(encode, *values)

    def _send(self, data: bytes) -> None:
        for tap in self._taps:
            tap(data)
        if self._is_read:
            self._publisher.publish(data)
