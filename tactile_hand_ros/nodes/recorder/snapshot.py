# SPDX-License-Identifier: Apache-2.0
"""The last seconds of a graph, kept in memory until a service call writes them."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from tactile_hand_ros.nodes.recorder.raw_topic import RawTopic


class Kept(NamedTuple):
    """One message with its times of reception and publication in ns."""

    topic: RawTopic
    data: bytes
    received: int
    sent: int


class SnapshotBuffer:
    """Keeps the messages of the last seconds, and of latched topics the last one however old."""

    def __init__(self, duration: float) -> None:
        """Keep messages for a duration in s."""
        self._duration = round(duration * 1e9)
        self._messages: deque[Kept] = deque()
        self._latched: dict[str, Kept] = {}

    def __len__(self) -> int:
        """Return the number of messages of the last seconds."""
        return len(self._messages)

    def add(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        """Keep a message and drop those that have become too old."""
        self._messages.append(Kept(topic, data, received, sent))
        while received - self._messages[0].received > self._duration:
            old = self._messages.popleft()
            if old.topic.latched:
                self._latched[old.topic.name] = old

    def take(self) -> list[Kept]:
        """Return all messages in the order of their reception, and forget all but the latched.

        Old latched ones come first, as if received together with the first of the others: a late
        joiner would have got them then.
        """
        fresh = sorted(self._messages, key=lambda kept: kept.received)
        self._messages.clear()
        begin = fresh[0].received if fresh else None
        latched = [
            kept._replace(received=begin or kept.received) for kept in self._latched.values()
        ]
        self._latched |= {kept.topic.name: kept for kept in fresh if kept.topic.latched}
        return [*latched, *fresh]
