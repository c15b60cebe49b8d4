# SPDX-License-Identifier: Apache-2.0
"""The messages that wait for one subscription, with the bounds of its quality of service."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription


class Inbox:
    """The messages that wait for one subscription; the oldest ones give way to new ones."""

    def __init__(self, subscription: Subscription, waiting: deque[Inbox]) -> None:
        """Start empty.

        Args:
            subscription: Whose callback takes the messages.
            waiting: Gets this inbox once for each message that waits in it.
        """
        self.subscription = subscription
        self.topic = subscription.topic_name
        self._messages: deque[bytes] = deque()
        self._depth = history_depth(subscription.qos_profile)
        self._waiting = waiting
        self._call = _callback_for_bytes(subscription)

    def put(self, data: bytes) -> None:
        """Add a message."""
        messages = self._messages
        if len(messages) == self._depth:
            messages.popleft()  # its turn is now that of the next one
        else:
            self._waiting.append(self)
        messages.append(data)

    def deliver(self) -> Any:
        """Call back with the oldest message, if it still waits, and return the result."""
        return self._call(self._messages.popleft()) if self._messages else None

    def clear(self) -> None:
        """Drop what waits."""
        self._messages.clear()


class Tap:
    """Calls a subscription back at once with what publishers of its process send, as bytes.

    For one that only keeps the bytes, such as a recorder's: the publisher waits for it.
    """

    def __init__(self, subscription: Subscription) -> None:
        """Take the callback of a subscription whose messages no executor takes."""
        self.subscription = subscription
        self.topic = subscription.topic_name
        self.put: Callable[[bytes], None] = subscription.callback

    def clear(self) -> None:
        """Do nothing: nothing waits."""


def history_depth(profile: QoSProfile) -> int | None:
    """Return how many messages a history holds, None for all."""
    return None if profile.history == HistoryPolicy.KEEP_ALL else max(1, profile.depth)


def _callback_for_bytes(subscription: Subscription) -> Callable[[bytes], Any]:
    """Return what calls a subscription back with a serialized message."""
    callback: Callable[..., Any] = subscription.callback
    kind, raw = subscription.msg_type, subscription.raw
    with_info = subscription._callback_type is Subscription.CallbackType.WithMessageInfo
    if raw and not with_info:
        return callback

    def call(data: bytes) -> Any:
        message = data if raw else deserialize_message(data, kind)
        return callback(message, *([_info()] if with_info else []))

    return call


def _info() -> dict[str, int | None]:
    """Return what a subscription may ask about a message, as far as it is known."""
    now = time.time_ns()
    unknown = {"publication_sequence_number": None, "reception_sequence_number": None}
    return {"source_timestamp": now, "received_timestamp": now, **unknown}
