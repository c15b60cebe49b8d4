# SPDX-License-Identifier: Apache-2.0
"""Who of the nodes of a process gets what from whom, and the order in which it is handed over."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.context import Context
from rclpy.subscription import Subscription

from tactile_hand_ros.ros.direct.inbox import Inbox, Tap
from tactile_hand_ros.ros.direct.publisher import DirectPublisher
from tactile_hand_ros.ros.direct_take import DirectTakeGroup


class DirectDelivery:
    """The publishers and subscriptions of all nodes of one context, served by one executor."""

    def __init__(self) -> None:
        """Start without endpoints."""
        self._inboxes: list[Inbox | Tap] = []
        self._publishers: list[DirectPublisher] = []
        self._waiting: deque[Inbox] = deque()
        self._thread = threading.get_ident()
        self._wake: Callable[[], None] = lambda: None
        self._at_rest: list[Callable[[], None]] = []
        self._on_publisher: list[Callable[[DirectPublisher], None]] = []

    def __bool__(self) -> bool:
        """Return whether messages wait."""
        return bool(self._waiting)

    def serve(self, wake: Callable[[], None]) -> None:
        """Note that this thread calls `deliver`, and how others wake it from its sleep."""
        self._thread, self._wake = threading.get_ident(), wake

    def note(self) -> None:
        """See to it that messages from another thread are noticed."""
        if threading.get_ident() != self._thread:
            self._wake()

    def deliver(self, finish: Callable[[Any], None]) -> None:
        """Call back with all messages that wait now, not with those that they lead to.

        Args:
            finish: Takes what a callback returns; of a coroutine function, what is to be awaited.
        """
        waiting = self._waiting
        for _ in range(len(waiting)):
            result = waiting.popleft().deliver()
            if result is not None:
                finish(result)

    def when_at_rest(self, callback: Callable[[], None]) -> None:
        """Call back again and again, each time that the nodes have answered each other."""
        self._at_rest.append(callback)

    def rest(self) -> None:
        """Do what can wait until the nodes have answered each other."""
        for callback in self._at_rest:
            callback()

    def add_publisher(self, publisher: DirectPublisher) -> None:
        """Let a publisher serve the subscriptions that match."""
        publisher.join(self.note, self.remove_publisher)
        self._publishers.append(publisher)
        for inbox in self._inboxes:
            if publisher.matches(inbox):
                publisher.link(inbox)
        for callback in self._on_publisher:
            callback(publisher)

    def when_published(self, callback: Callable[[DirectPublisher], None]) -> None:
        """Call back for each publisher that joins, before it publishes."""
        self._on_publisher.append(callback)

    def remove_publisher(self, publisher: DirectPublisher) -> None:
        """Forget a publisher; what it has sent is delivered all the same."""
        self._publishers.remove(publisher)

    def add_subscription(self, subscription: Subscription) -> None:
        """Let a subscription take from the publishers that match."""
        is_taken = isinstance(subscription.callback_group, DirectTakeGroup)
        inbox = Tap(subscription) if is_taken else Inbox(subscription, self._waiting)
        self._inboxes.append(inbox)
        for publisher in self._publishers:
            if publisher.matches(inbox):
                publisher.link(inbox)

    def remove_subscription(self, subscription: Subscription) -> None:
        """Forget a subscription and what waits for it."""
        for inbox in self._inboxes:
            if inbox.subscription is subscription:
                self._inboxes.remove(inbox)
                inbox.clear()
                for publisher in self._publishers:
                    publisher.unlink(inbox)
                return

    def publisher_count(self, subscription: Subscription) -> int:
        """Return how many publishers of this process a subscription takes from."""
        return sum(
            inbox.subscription is subscription
            for publisher in self._publishers
            for inbox in publisher.inboxes
        )


_deliveries: WeakKeyDictionary[Context, DirectDelivery] = WeakKeyDictionary()


def deliver_directly(context: Context) -> None:
    """Let the nodes that are made in a context hand messages to each other.

    Its endpoints must not match each other in the middleware, and a single `WaitSetExecutor` must
    serve all of its nodes.
    """
    _deliveries[context] = DirectDelivery()


def direct_delivery(context: Context) -> DirectDelivery | None:
    """Return what delivers between the nodes of a context, None where the middleware does."""
    return _deliveries.get(context)
