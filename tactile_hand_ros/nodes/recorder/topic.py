# SPDX-License-Identifier: Apache-2.0
"""One subscribed topic: serialized messages taken straight from its queue, and what is missing."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros import names
from tactile_hand_ros.ros.endpoints import message_class, subscribe_directly, taken

Sink = Callable[["RawTopic", bytes, int, int], None]  # topic, CDR, received ns, sent ns

_DISCOVERY = 2.0
"""A publisher discovered so soon after subscribing may be older than the subscription [s]."""


def publishers_of(node: Node, topic: str) -> Sequence[TopicEndpointInfo]:
    """Return the publishers of a topic; none where the context has been shut down."""
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
        received: Number of messages taken.
        channel: Number of the topic's channel in the bag, None until it has one.
    """

    def __init__(self, node: Node, name: str, type_name: str, depth: int) -> None:
        """Subscribe.

        Args:
            node: Owner of the subscription.
            name: Full name of the topic.
            type_name: Full name of its type.
            depth: Length of its queue.

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
        self._qos = adapted_qos(publishers, depth)
        self._subscription = self._subscribe()
        self._present = self._known = {bytes(each.endpoint_gid) for each in publishers}
        self._settled = time.monotonic() + _DISCOVERY
        self._sequence = SequenceTracker(len(publishers), self._look)

    @property
    def publishers(self) -> int:
        """Number of publishers at the last look."""
        return len(self._present)

    @property
    def lost(self) -> int:
        """Number of messages that never came.

        Counted are those of publishers that are older than the subscription from the first received
        one on, and all of publishers that appeared later.
        """
        return self._sequence.lost

    def drain(self, sink: Sink) -> int:
        """Hand all waiting messages to `sink` and return their number."""
        count = 0
        for data, received, sent in self._take():
            sink(self, data, received, sent)
            count += 1
        return count

    def adapt(self, sink: Sink) -> bool:
        """Subscribe again if the publishers changed so that the present subscription misses some.

        As many publishers as before need not be the same: one that was replaced by another of a
        weaker quality of service does not match. A latched topic is subscribed again only before
        its first message: later its publishers' histories would arrive a second time.

        Returns:
            Whether a publisher came or went.
        """
        count = self._node.count_publishers(self.name)
        if count == self.publishers == self._subscription.get_publisher_count():
            return False
        before = self._present
        publishers = publishers_of(self._node, self.name)
        self._count_publishers(publishers)
        qos = adapted_qos(publishers, self._qos.depth)
        upgrade = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL != self._qos.durability
        if publishers and (_is_weaker(qos, self._qos) or (upgrade and not self.received)):
            old, self._qos = self._subscription, qos
            new = self._subscribe()
            self.drain(sink)
            self._subscription = new
            self._node.destroy_subscription(old)
        return self._present != before

    def _look(self) -> None:
        """Find publishers that appeared since the last look."""
        if publishers := publishers_of(self._node, self.name):
            self._count_publishers(publishers)

    def _count_publishers(self, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Separate publishers that may be older than the subscription and those that are not.

        Of a latched topic a late subscription gets the last messages only, by design.
        """
        self._present = {bytes(publisher.endpoint_gid) for publisher in publishers}
        new = len(self._present - self._known)
        self._known = self._known | self._present
        is_latched = self._qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        # What a node publishes on its own topics while it starts is no loss of the recording.
        is_free = is_latched or self.name in names.OF_ALL_NODES
        if is_free or time.monotonic() < self._settled:
            self._sequence.change(self.publishers, older=new)
        else:
            self._sequence.change(self.publishers, younger=new)

    def _subscribe(self) -> Subscription:
        return subscribe_directly(self._node, self._class, self.name, self._qos)

    def _take(self) -> Iterator[tuple[bytes, int, int]]:
        """Yield data, time of reception and time of publication (ns) of the waiting messages."""
        for data, info in taken(self._subscription, self._qos.depth):
            self.received += 1
            number = info["publication_sequence_number"]
            if number is not None:
                self._sequence.see(number)
            received = info["received_timestamp"] or time.time_ns()
            yield data, received, info["source_timestamp"] or received


def _is_weaker(new: QoSProfile, old: QoSProfile) -> bool:
    """Return whether a policy must give way so that all publishers match."""
    return bool(
        new.reliability == ReliabilityPolicy.BEST_EFFORT != old.reliability
        or new.durability == DurabilityPolicy.VOLATILE != old.durability
    )


class SequenceTracker:
    """Counts the gaps in the sequence numbers of one topic.

    Each publisher numbers its messages 1, 2, 3, ... but a message does not state whose number it
    carries. A number that continues any known publisher belongs to it; number 1 is a new
    publisher; any other number is a gap in the nearest publisher below it. For one publisher the
    count is exact; for several that lose messages together it is an estimate.

    A publisher that may be older than the subscription can start with any number. One that appears
    later starts with 1: what it publishes before it finds the subscription is lost.

    Attributes:
        lost: Number of messages that never came.
    """

    def __init__(self, publishers: int = 1, look: Callable[[], None] = lambda: None) -> None:
        """Start before the first message.

        Args:
            publishers: How many publishers are older than the subscription.
            look: Called before a number out of order is judged; may call `change`.
        """
        self.lost = 0
        self._look = look
        self._older = publishers  # of which nothing was received yet
        self._younger = 0
        self._next: Counter[int] = Counter()

    def change(self, present: int, older: int = 0, younger: int = 0) -> None:
        """Account for publishers that came or went.

        Args:
            present: How many there are now.
            older: How many were discovered that may be older than the subscription.
            younger: How many were discovered that are not.
        """
        self._older = min(self._older + older, present)
        self._younger = min(self._younger + younger, present)

    def see(self, number: int) -> None:
        """Account for one received message.

        Args:
            number: Sequence number, from 1.
        """
        if not self._next[number]:
            self._look()
            self._open(number)
        self._take(number)
        self._next[number + 1] += 1

    def _open(self, number: int) -> None:
        """Make `number` an expected one: of a new publisher, or behind a gap."""
        del self._next[number]
        below = [expected for expected in self._next if expected < number]
        if self._older:
            self._older -= 1
        elif self._younger:
            self._younger -= 1
            self.lost += number - 1
        elif number > 1 and below:
            nearest = max(below)
            self.lost += number - nearest
            self._take(nearest)
        self._next[number] += 1

    def _take(self, number: int) -> None:
        """Remove one publisher of which `number` was expected."""
        self._next[number] -= 1
        if not self._next[number]:
            del self._next[number]
