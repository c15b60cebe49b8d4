# SPDX-License-Identifier: Apache-2.0
"""One subscribed topic: serialized messages taken straight from its queue."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.sequence import SequenceTracker

Sink = Callable[["RawTopic", bytes, int, int], None]  # topic, CDR, received ns, sent ns


class DirectTakeGroup(CallbackGroup):
    """Keeps its subscriptions out of every executor: somebody takes their messages directly.

    An executor would rebuild its wait set and wake up for each message, which costs ten times
    as much as taking the message.
    """

    def can_execute(self, entity: Any) -> bool:
        """Refuse, so that no executor waits for the entity."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Refuse."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: nothing was begun."""


def message_class(type_name: str) -> Any:
    """Return the Python class of a message type.

    Args:
        type_name: Full name, e.g. ``sensor_msgs/msg/JointState``.

    Raises:
        BagError: If the type is not installed.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError):
        raise BagError(
            f"The message type '{type_name}' is not installed, expected a package with it in "
            "this environment; install or source it to record its topics."
        ) from None


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
        group: DirectTakeGroup,
        name: str,
        type_name: str,
        publishers: Sequence[TopicEndpointInfo],
        depth: int,
    ) -> None:
        """Subscribe.

        Args:
            node: Owner of the subscription.
            group: Group that keeps the subscription out of the node's executor.
            name: Full name of the topic.
            type_name: Full name of its type.
            publishers: Its present publishers, whose offers are accepted.
            depth: Length of its queue.

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
        self._group = group
        self._qos = adapted_qos(publishers, depth)
        self._subscription = self._subscribe()
        self._sequence = SequenceTracker(len(publishers))

    @property
    def latched(self) -> bool:
        """Whether late subscribers get the last message of the topic."""
        return bool(self._qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def lost(self) -> int:
        """Number of messages that were published after the first received one and never came."""
        return self._sequence.lost

    def drain(self, sink: Sink) -> int:
        """Hand all waiting messages to `sink` and return their number."""
        count = 0
        for data, received, sent in self._take():
            sink(self, data, received, sent)
            count += 1
        return count

    def adapt(self, publishers: Sequence[TopicEndpointInfo], sink: Sink) -> None:
        """Subscribe anew if the publishers changed so that the present subscription misses some.

        A latched topic is subscribed anew only before its first message: later its publishers'
        histories would arrive a second time.
        """
        self.publishers = self._sequence.publishers = len(publishers)
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

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            self._class,
            self.name,
            _never_called,
            self._qos,
            callback_group=self._group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )

    def _take(self) -> Iterator[tuple[bytes, int, int]]:
        """Yield data, time of reception and time of publication (ns) of the waiting messages."""
        handle = self._subscription.handle
        see = self._sequence.see
        with handle:
            for _ in range(self._qos.depth):  # bounded: a flood must not starve other topics
                taken = handle.take_message(self._class, True)
                if taken is None:
                    return
                data, info = taken
                self.received += 1
                number = info["publication_sequence_number"]
                if number is not None:
                    see(number)
                received = info["received_timestamp"] or time.time_ns()
                yield data, received, info["source_timestamp"] or received


def _weaker(new: QoSProfile, old: QoSProfile) -> bool:
    """Return whether a policy must give way so that all publishers match."""
    return bool(
        new.reliability == ReliabilityPolicy.BEST_EFFORT != old.reliability
        or new.durability == DurabilityPolicy.VOLATILE != old.durability
    )


def _never_called(_: bytes) -> None:
    """Stand in for a callback: the messages are taken directly."""
