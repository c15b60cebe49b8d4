# SPDX-License-Identifier: Apache-2.0
"""Messages between the nodes of one process, handed over as bytes without the middleware.

ROS 2 has this for C++ nodes only. Here each publisher puts its bytes into an inbox of every
subscription of the same process, and the executor calls the subscriptions after the publisher's
callback has returned. The middleware gets a copy only while a subscription elsewhere matches, and
still delivers what publishers elsewhere send. It must not match endpoints of the same process, or
everything would arrive twice: see `middleware.share_process`.

Quality of service is that of the wire: only compatible endpoints meet, an inbox holds as many
messages as the history of its subscription, and a latched message reaches subscriptions that come
later. The order of the messages is that in which they were published.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.context import Context
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    qos_check_compatible,
)
from rclpy.serialization import deserialize_message, serialize_message
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
        self._depth = _depth(subscription.qos_profile)
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


class DirectPublisher(Publisher):
    """A publisher that serves the subscriptions of its process itself.

    Serialized messages go to the middleware only while a subscription elsewhere matches. Message
    objects always go there too: they are rare, and then nothing else changes for them.
    """

    _delivery: DirectDelivery

    def join(self, delivery: DirectDelivery) -> None:
        """Begin to serve subscriptions of this process."""
        self._delivery = delivery
        self._full_topic = self.topic_name
        self.inboxes: tuple[Inbox, ...] = ()
        self._is_latched = self._is_read_here = _is_latched(self.qos_profile)
        self._kept: deque[bytes] = deque(maxlen=_depth(self.qos_profile))
        # Held until `destroy`, which saves a third of the cost of a message.
        self._native = self.handle
        self._native.__enter__()
        delivery.add_publisher(self)

    def publish(self, msg: Any) -> None:
        """Send a message, which may be serialized, to whoever has subscribed."""
        if type(msg) is bytes:
            if self._is_read_here:
                self._hand_over(msg)
            if self._native.get_subscription_count():
                self._native.publish_raw(msg)
        else:
            super().publish(msg)  # also refuses what is not a message of this type
            if self._is_read_here:
                self._hand_over(serialize_message(msg))

    def _hand_over(self, data: bytes) -> None:
        for inbox in self.inboxes:
            inbox.put(data)
        if self._is_latched:
            self._kept.append(data)
        self._delivery.note()

    def matches(self, inbox: Inbox) -> bool:
        """Return whether a subscription takes what this publisher offers."""
        if inbox.topic != self._full_topic:  # which has one type in a process
            return False
        wanted = inbox.subscription.qos_profile
        return bool(qos_check_compatible(self.qos_profile, wanted)[0] != QoSCompatibility.ERROR)

    def link(self, inbox: Inbox) -> None:
        """Serve one more subscription, and give it what is kept for those that come later."""
        self.inboxes = (*self.inboxes, inbox)
        self._is_read_here = True
        if _is_latched(inbox.subscription.qos_profile):
            for data in self._kept:
                inbox.put(data)

    def unlink(self, inbox: Inbox) -> None:
        """Stop serving a subscription."""
        self.inboxes = tuple(each for each in self.inboxes if each is not inbox)
        self._is_read_here = bool(self.inboxes) or self._is_latched

    def get_subscription_count(self) -> int:
        """Return the number of matching subscriptions, in this process and elsewhere."""
        return int(super().get_subscription_count()) + len(self.inboxes)

    def destroy(self) -> None:
        """Leave the subscriptions and destroy the publisher."""
        self._delivery.remove_publisher(self)
        super().destroy()
        self._native.__exit__(None, None, None)


class DirectDelivery:
    """The publishers and subscriptions of all nodes of one context, served by one executor."""

    def __init__(self) -> None:
        """Start without endpoints."""
        self._inboxes: list[Inbox] = []
        self._publishers: list[DirectPublisher] = []
        self._waiting: deque[Inbox] = deque()
        self._thread = threading.get_ident()
        self._wake: Callable[[], None] = lambda: None

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

    def add_publisher(self, publisher: DirectPublisher) -> None:
        """Let a publisher serve the subscriptions that match."""
        self._publishers.append(publisher)
        for inbox in self._inboxes:
            if publisher.matches(inbox):
                publisher.link(inbox)

    def remove_publisher(self, publisher: DirectPublisher) -> None:
        """Forget a publisher; what it has sent is delivered all the same."""
        self._publishers.remove(publisher)

    def add_subscription(self, subscription: Subscription) -> None:
        """Let a subscription take from the publishers that match."""
        inbox = Inbox(subscription, self._waiting)
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


def _depth(profile: QoSProfile) -> int | None:
    """Return how many messages a history holds, None for all."""
    return None if profile.history == HistoryPolicy.KEEP_ALL else max(1, profile.depth)


def _is_latched(profile: QoSProfile) -> bool:
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


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
