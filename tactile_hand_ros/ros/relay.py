# SPDX-License-Identifier: Apache-2.0
"""Tick messages for viewers: many in one message, a few times a second.

A subscription to a tick topic costs its publisher a packet per tick, a tenth of the time of an
in-process tick, and a viewer would need twenty. A relay sends all tick messages of a node in one
message per picture instead. Without a subscriber it does nothing.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from std_msgs.msg import UInt8MultiArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import byte_array, packed, unpacked
from tactile_hand_ros.ros import qos

PERIOD = 1.0 / 30.0
"""Time between two batches [s]: that between two pictures."""

_LARGEST = 1_000_000
"""Bytes kept between two batches; a node that computes faster than that loses messages here."""


class TickRelay:
    """Publishes `_ticks/<node>` (std_msgs/UInt8MultiArray): serialized messages by topic.

    Its data are `packed` parts in pairs: the name of a topic below the namespace, and its messages,
    which are `packed` too.
    """

    def __init__(self, node: Node, publishers: Sequence[Any]) -> None:
        """Create the publisher; `publishers` may grow until it is served."""
        self._prefix = node.get_namespace().rstrip("/") + "/"
        self._sources = publishers
        topic = names.ticks_of(node.get_name())
        self._publisher = node.create_publisher(UInt8MultiArray, topic, qos.USER_DEPTH)
        self._waiting: dict[str, bytearray] = {}
        self._taps: list[tuple[Any, Callable[[bytes], None]]] = []
        node.create_timer(PERIOD, self._on_timer)

    def _on_timer(self) -> None:
        if not self._publisher.get_subscription_count():
            self._detach()
            return
        if not self._taps:
            self._attach()
        if any(self._waiting.values()):
            self._publisher.publish(self._batch())

    def _attach(self) -> None:
        for source in self._sources:
            waiting = self._waiting.setdefault(source.topic, bytearray())
            tap = partial(_keep, waiting)
            self._taps.append((source, tap))
            source.taps.append(tap)

    def _detach(self) -> None:
        for source, tap in self._taps:
            source.taps.remove(tap)
        self._taps.clear()
        self._waiting.clear()

    def _batch(self) -> UInt8MultiArray:
        parts: list[bytes] = []
        for topic, data in self._waiting.items():
            parts += [topic.removeprefix(self._prefix).encode(), bytes(data)]
            data.clear()
        return UInt8MultiArray(data=array.array("B", packed(parts)))


def _keep(waiting: bytearray, data: bytes) -> None:
    if len(waiting) < _LARGEST:
        waiting += packed([data])


def batch_by_topic(data: bytes) -> dict[str, bytes]:
    """Return the `packed` messages in a serialized batch by topic, oldest first.

    Raises:
        MessageError: If it is not a batch.
    """
    parts = unpacked(byte_array(data))
    topics = [name.decode(errors="replace") for name in parts[::2]]
    return dict(zip(topics, parts[1::2], strict=False))
