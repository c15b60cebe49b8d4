# SPDX-License-Identifier: Apache-2.0
"""Messages taken straight from the queue of a subscription, without an executor.

An executor would rebuild its wait set and wake up for each message, which costs ten times as much
as taking the message. ``take_message`` of the object behind the public ``handle`` is not public.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

_ALL = 1_000_000


class DirectTakeGroup(CallbackGroup):
    """Keeps its subscriptions out of every executor."""

    def can_execute(self, entity: Any) -> bool:
        """Return False, so that no executor waits for the entity."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: nothing was begun."""


def _ignore(_: bytes) -> None:
    """Stand in for a callback."""


def subscribe_directly(
    node: Node,
    kind: Any,
    topic: str,
    profile: QoSProfile,
    **options: Any,
) -> Subscription:
    """Subscribe to serialized messages that are only taken with `taken` or `take_latest`.

    Args:
        node: Owner of the subscription.
        kind: Message class.
        topic: Name of the topic.
        profile: Quality of service.
        **options: For `rclpy.node.Node.create_subscription`.
    """
    group = DirectTakeGroup()
    # No executor would take an event, and each would wake for it again and again.
    options.setdefault("event_callbacks", SubscriptionEventCallbacks(use_default_callbacks=False))
    return node.create_subscription(
        kind, topic, _ignore, profile, callback_group=group, raw=True, **options
    )


def taken(subscription: Subscription, limit: int = _ALL) -> Iterator[tuple[Any, Any]]:
    """Take the waiting messages, oldest first; bytes where the subscription is raw.

    Args:
        subscription: Which no executor serves at the same time.
        limit: Maximum number of messages to take: a flood must not starve other topics.

    Yields:
        A message and what the middleware reports about it.
    """
    handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
    with handle:
        for _ in range(limit):
            item = handle.take_message(kind, raw)
            if item is None:
                return
            yield item


def take_latest(subscription: Subscription) -> Any:
    """Take everything that has arrived and return the newest message, None if there is none."""
    newest = None
    for newest, _ in taken(subscription):
        pass
    return newest
