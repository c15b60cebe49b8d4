# SPDX-License-Identifier: Apache-2.0
"""One subscribed topic: serialized messages taken directly from its queue, and lost messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.ros.endpoints import message_class, subscribe_directly, taken

Sink = Callable[["RawTopic", bytes, int, int], None]  # topic, CDR, received ns, sent ns

_DISCOVERY = 2.0
"""Time after subscribing in which a new publisher may be older than the subscription [s]."""


def publishers_of(node: Node, topic: str) -> Sequence[TopicEndpointInfo]:
    """Return the publishers of a topic, or an empty list if the context is shut down."""
    try:
        return list(node.get_publishers_info_by_topic(topic))
    except (RuntimeError, InvalidHandle):  # errors of rcl are RuntimeErrors
        return []


def adapted_qos(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strictest quality of service that every publisher satisfies.

    Without publishers this is reliable and volatile, which almost all publishers satisfy.

    Source: ``Rosbag2QoS::adapt_request_to_offers`` of rosbag2.
    """
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if latched and profiles else DurabilityPolicy.VOLATILE
        ),
    )


class RawTopic:
    """A subscription whose messages are taken as bytes, with its counters.

    Attributes:
        name: Full name of the topic.
        type_name: Full name of its type.
        publishers: Number of publishers at the last poll.
        received: Number of messages taken.
        channel: Number of the topic's channel in the bag, None until it has one.
    """

    def __init__(self, node: Node, name: str, type_name: str, depth: int) -> None:
        """Subscribe with a queue of length `depth`.

        Raises:
            BagError: If the type is not installed.
        """
        self.name = name
        self.type_name = type_name
        self.received = 0
        self.channel: int | None = None
        self._class = message_class(type_name)
        self._node = node
        publishers = publishers_of(node, name)
        self.publishers = len(publishers)
        self._qos = adapted_qos(publishers, depth)
        self._subscription = self._subscribe()
        self._losses = LossCounter(self._publisher_ids, self._forgiving_until)

    @property
    def lost(self) -> int:
        """Number of lost messages."""
        return self._losses.count

    @property
    def _forgiving_until(self) -> float:
        """Infinity for latched topics, whose late subscribers get only the last messages."""
        is_latched = self._qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        return math.inf if is_latched else time.monotonic() + _DISCOVERY

    def drain(self, sink: Sink) -> int:
        """Pass all waiting messages to `sink` and return their number."""
        before = self.received
        for data, info in taken(self._subscription, self._qos.depth):
            self.received += 1
            number = info["publication_sequence_number"]
            if number is not None:
                self._losses.note(number)
            received = info["received_timestamp"] or time.time_ns()
            sink(self, data, received, info["source_timestamp"] or received)
        return self.received - before

    def adapt(self, sink: Sink) -> bool:
        """Subscribe again if needed to match all publishers; return whether their number changed.

        An unchanged number of publishers is not enough: a replacement with a weaker quality of
        service does not match. A latched topic is subscribed again only before its first message;
        later, its publishers' histories would arrive twice.
        """
        before, count = self.publishers, self._node.count_publishers(self.name)
        if count == before == self._subscription.get_publisher_count():
            return False
        publishers = publishers_of(self._node, self.name)
        self.publishers = len(publishers)
        qos = adapted_qos(publishers, self._qos.depth)
        upgrade = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL != self._qos.durability
        if publishers and (_is_weaker(qos, self._qos) or (upgrade and not self.received)):
            old, self._qos = self._subscription, qos
            new = self._subscribe()
            self._losses.forgiving_until = max(self._losses.forgiving_until, self._forgiving_until)
            self.drain(sink)
            self._subscription = new
            self._node.destroy_subscription(old)
        return self.publishers != before

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)

    def _publisher_ids(self) -> set[bytes]:
        return {bytes(each.endpoint_gid) for each in publishers_of(self._node, self.name)}

    def _subscribe(self) -> Subscription:
        return subscribe_directly(self._node, self._class, self.name, self._qos)


class LossCounter:
    """Counts the lost messages of a topic.

    The middleware numbers the messages of each publisher 1, 2, 3, ... but a message does not name
    its publisher. So losses are counted only while a topic has one publisher, as every topic of a
    hand does: gaps, and the messages that a publisher newer than the subscription sent before the
    two matched.

    Attributes:
        count: Number of lost messages.
        forgiving_until: Until then, a publisher may be older than the subscription [s, monotonic].
    """

    def __init__(self, look: Callable[[], set[bytes]], forgiving_until: float) -> None:
        """Start with a subscription; `look` returns the ids of the current publishers."""
        self.count, self.forgiving_until = 0, forgiving_until
        self._look, self._older = look, look()
        self._sender, self._next = b"", 1

    def note(self, number: int) -> None:
        """Check the sequence number of a message, from 1."""
        expected, self._next = self._next, number + 1
        if number == expected and self._sender:
            return
        present = self._look()
        if len(present) != 1:  # the number may belong to any of them
            self._sender, self._older = b"", self._older | present
            return
        (sender,) = present
        if sender == self._sender:
            self.count += max(0, number - expected)  # else of a publisher that has left
        elif sender not in self._older and time.monotonic() >= self.forgiving_until:
            self.count += number - 1
        self._sender = sender


def _is_weaker(new: QoSProfile, old: QoSProfile) -> bool:
    """Return whether a policy is weaker, as needed to match all publishers."""
    return bool(
        new.reliability == ReliabilityPolicy.BEST_EFFORT != old.reliability
        or new.durability == DurabilityPolicy.VOLATILE != old.durability
    )
