# SPDX-License-Identifier: Apache-2.0
"""One subscribed topic: serialized messages taken straight from its queue."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.nodes.recorder.sequence import SequenceTracker
from tactile_hand_ros.ros.direct.delivery import direct_delivery
from tactile_hand_ros.ros.direct_take import subscribe_directly, taken
from tactile_hand_ros.ros.messages.types import message_class

Sink = Callable[["RawTopic", bytes, int, int], None]  # topic, CDR, received ns, sent ns
Tapped = tuple["RawTopic", bytes, int]  # topic, CDR, sent ns

_DISCOVERY = 2.0
"""A publisher discovered so soon after subscribing may be older than the subscription [s]."""


def adapted_qos(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strictest quality of service that every publisher satisfies.

    Without publishers this is reliable and volatile, which most publishers satisfy.

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
        publishers: Number of publishers at the last adaptation.
        received: Number of messages taken.
        channel: Number of the topic's channel in the bag, None until it has one.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        type_name: str,
        publishers: Sequence[TopicEndpointInfo],
        depth: int,
        tapped: list[Tapped] | None = None,
    ) -> None:
        """Subscribe.

        Args:
            node: Owner of the subscription.
            name: Full name of the topic.
            type_name: Full name of its type.
            publishers: Its present publishers, whose offers are accepted.
            depth: Length of its queue.
            tapped: Gets what publishers of this process send, if they deliver directly.

        Raises:
            BagError: If the type is not installed.
        """
        self.name = name
        self.type_name = type_name
        self.publishers = len(publishers)
        self.received = 0
        self.channel: int | None = None
        self._class = message_class(type_name)
        self._node = node
        self._direct = direct_delivery(node.context)
        self._tapped: list[Tapped] = [] if tapped is None else tapped
        self._qos = adapted_qos(publishers, depth)
        self._subscription = self._subscribe()
        self._known = {bytes(publisher.endpoint_gid) for publisher in publishers}
        self._settled = time.monotonic() + _DISCOVERY
        self._inside = self._publishers_inside()
        self._sequence = SequenceTracker(len(publishers) - self._inside, self._look)

    @property
    def latched(self) -> bool:
        """Whether late subscribers get the last message of the topic."""
        return bool(self._qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def lost(self) -> int:
        """Number of messages that never came.

        Counted are those of publishers that are older than the subscription from the first received
        one on, and all of publishers that appeared later.
        """
        return self._sequence.lost

    @property
    def is_remote(self) -> bool:
        """Whether the topic has publishers in other processes."""
        return self.publishers > self._inside

    def drain(self, sink: Sink) -> int:
        """Hand all waiting messages to `sink` and return their number."""
        count = 0
        for data, received, sent in self._take():
            sink(self, data, received, sent)
            count += 1
        return count

    def adapt(self, publishers: Sequence[TopicEndpointInfo], sink: Sink) -> None:
        """Subscribe again if the publishers changed so that the present subscription misses some.

        A latched topic is subscribed again only before its first message: later its publishers'
        histories would arrive a second time.
        """
        self.publishers = len(publishers)
        self._count_publishers(publishers)
        qos = adapted_qos(publishers, self._qos.depth)
        upgrade = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL != self._qos.durability
        downgrade = _weaker(qos, self._qos)
        if not publishers or not (downgrade or (upgrade and not self.received)):
            return
        old, self._qos = self._subscription, qos
        new = self._subscribe()
        self.drain(sink)
        self._subscription = new
        self._node.destroy_subscription(old)

    def end(self) -> None:
        """Take no more messages."""
        self._node.destroy_subscription(self._subscription)

    def _look(self) -> None:
        """Find publishers that appeared since the last adaptation."""
        self._count_publishers(self._node.get_publishers_info_by_topic(self.name))

    def _count_publishers(self, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Separate publishers that may be older than the subscription and those that are not.

        Of a latched topic a late subscription gets the last messages only, by design.
        """
        present = {bytes(publisher.endpoint_gid) for publisher in publishers}
        new = len(present - self._known)
        self._known |= present
        self._inside = self._publishers_inside()
        outside = len(present) - self._inside  # the others' messages have no numbers
        if self.latched or time.monotonic() < self._settled:
            self._sequence.change(outside, older=new)
        else:
            self._sequence.change(outside, younger=new)

    def _publishers_inside(self) -> int:
        """Return how many publishers of this process deliver directly."""
        return 0 if self._direct is None else self._direct.publisher_count(self._subscription)

    def _subscribe(self) -> Subscription:
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        return subscribe_directly(
            self._node, self._class, self.name, self._qos, self._tap, event_callbacks=quiet
        )

    def _tap(self, data: bytes) -> None:
        self.received += 1
        self._tapped.append((self, data, time.time_ns()))

    def _take(self) -> Iterator[tuple[bytes, int, int]]:
        """Yield data, time of reception and time of publication (ns) of the waiting messages."""
        for data, info in taken(self._subscription, self._qos.depth):
            self.received += 1
            number = info["publication_sequence_number"]
            if number is not None:
                self._sequence.see(number)
            received = info["received_timestamp"] or time.time_ns()
            yield data, received, info["source_timestamp"] or received


def _weaker(new: QoSProfile, old: QoSProfile) -> bool:
    """Return whether a policy must give way so that all publishers match."""
    return bool(
        new.reliability == ReliabilityPolicy.BEST_EFFORT != old.reliability
        or new.durability == DurabilityPolicy.VOLATILE != old.durability
    )
