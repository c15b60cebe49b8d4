# SPDX-License-Identifier: Apache-2.0
"""Tick messages for viewers: many in one message, a few times a second.

A subscription to a tick topic costs its publisher a packet per tick, a tenth of the time of an
in-process tick, and a viewer would need twenty. A relay sends all tick messages of a node in one
message per picture instead. Without a subscriber it does nothing.
"""

from __future__ import annotations

import array
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray

from tactile_hand_ros import names
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros import qos

PERIOD = 1.0 / 30.0
"""Time between two batches [s]: that between two pictures."""

_LENGTH = struct.Struct("<I")
_LARGEST = 1_000_000
"""Bytes kept between two batches; a node that computes faster than that loses messages here."""


class TickRelay:
    """Publishes `_ticks/<node>` (std_msgs/UInt8MultiArray): serialized messages by topic.

    Each dimension of the layout is a topic: `label` its name below the namespace, `size` the bytes
    of all its messages, each with its length before it.
    """

    def __init__(self, node: Node, publishers: Sequence[Any]) -> None:
        """Create the publisher; `publishers` may grow later."""
        self._prefix = node.get_namespace().rstrip("/") + "/"
        self._sources = publishers
        topic = names.ticks_of(node.get_name())
        self._publisher = node.create_publisher(UInt8MultiArray, topic, qos.user_qos())
        self._waiting: dict[str, bytearray] = {}
        self._taps: list[tuple[Any, Callable[[bytes], None]]] = []
        node.create_timer(PERIOD, self._on_timer)

    def _on_timer(self) -> None:
        if not self._publisher.get_subscription_count():
            self._detach()
            return
        if len(self._taps) < len(self._sources):
            self._detach()
            self._attach()
        if any(self._waiting.values()):
            self._publisher.publish(self._batch())

    def _attach(self) -> None:
        for source in self._sources:
            waiting = self._waiting.setdefault(source.topic, bytearray())
            tap = partial(_keep, waiting)
            self._taps.append((source, tap))
            source.add_tap(tap)

    def _detach(self) -> None:
        for source, tap in self._taps:
            source.remove_tap(tap)
        self._taps.clear()
        self._waiting.clear()

    def _batch(self) -> UInt8MultiArray:
        message = UInt8MultiArray(data=array.array("B", b"".join(self._waiting.values())))
        for topic, data in self._waiting.items():
            label = topic.removeprefix(self._prefix)
            message.layout.dim.append(MultiArrayDimension(label=label, size=len(data)))
            data.clear()
        return message


def _keep(waiting: bytearray, data: bytes) -> None:
    if len(waiting) < _LARGEST:
        waiting += _LENGTH.pack(len(data)) + data


def unpack_batch(message: UInt8MultiArray) -> dict[str, list[bytes]]:
    """Return the messages of a batch by topic, oldest first.

    Raises:
        MessageError: If sizes and data contradict each other.
    """
    data, at, found = message.data.tobytes(), 0, dict[str, list[bytes]]()
    for part in message.layout.dim:
        end, messages = at + part.size, found.setdefault(part.label, [])
        while at < end <= len(data) and at + _LENGTH.size <= end:
            start = at + _LENGTH.size
            at = start + _LENGTH.unpack_from(data, at)[0]
            messages.append(data[start:at])
        if at != end:
            raise MessageError(f"{part.label}: {part.size} bytes that are not a batch of messages")
    return found
