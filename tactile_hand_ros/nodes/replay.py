# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag with its topics, bytes and timing, for machines without rosbag2."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader

from tactile_hand_ros.bag.reader import iterate, open_bag
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder.config import TopicSelection
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.ros.middleware import graph_node, ros_context

_DEPTH = 1000  # messages that a publisher keeps for slow subscribers
_LOOK = 0.1  # s between two calls of `watch`
_LAST_CALL = Duration(seconds=1)  # maximum wait for subscribers to take the last messages


class Replay:
    """Publishes the messages of a bag.

    Attributes:
        publishers: The publishers, by the name of the topic in the bag.
        skipped: Topics that cannot be published, with the reason.
        duration: Length of the bag [s].
        position: Time in the bag of the last message, s after the first.
        messages: Number of messages published.
    """

    def __init__(
        self, node: Node, reader: AnyReader, selection: TopicSelection, namespace: str = ""
    ) -> None:
        """Create the publishers of the selected topics, below the namespace.

        Raises:
            BagError: If no topic is left to publish.
        """
        self._reader = reader
        self._connections = [c for c in reader.connections if c.topic in selection]
        self.publishers: dict[str, Publisher] = {}
        self.skipped: dict[str, str] = {}
        self.duration = 1e-9 * (reader.end_time - reader.start_time)
        self.position, self.messages = 0.0, 0
        for topic in dict.fromkeys(c.topic for c in self._connections):
            recorded = [c for c in self._connections if c.topic == topic]
            offers = getattr(recorded[0].ext, "offered_qos_profiles", [])
            profile = offered_qos(offers, sum(c.msgcount for c in recorded))
            try:
                kind = message_class(recorded[0].msgtype)
            except BagError as error:
                self.skipped[topic] = str(error)
            else:
                self.publishers[topic] = node.create_publisher(kind, namespace + topic, profile)
        if not self.publishers or not reader.message_count:
            why = "; ".join(self.skipped.values()) or "--topics and --exclude leave none"
            why = why if reader.message_count else "it has no message"
            raise BagError(f"No topic of the bag {reader.paths[0]} can be published: {why}")

    def run(self, rate: float = 1.0, watch: Callable[[], None] = lambda: None) -> None:
        """Publish until the end at `rate` times the recorded speed; call `watch` every 0.1 s."""
        began, pause = time.monotonic(), threading.Event()
        chosen = [c for c in self._connections if c.topic in self.publishers]
        for connection, log_time, data in iterate(self._reader, chosen):
            position = 1e-9 * (log_time - self._reader.start_time)
            while (ahead := began + position / rate - time.monotonic()) > 0.0:
                pause.wait(min(ahead, _LOOK))
                self.position = min(position, rate * (time.monotonic() - began))
                watch()
            self.publishers[connection.topic].publish(bytes(data))
            self.position, self.messages = position, self.messages + 1
        for publisher in self.publishers.values():
            publisher.wait_for_all_acked(_LAST_CALL)
        watch()


def offered_qos(offers: Sequence[Any], count: int) -> QoSProfile:
    """Return the quality of service to publish with, from the profiles of a bag.

    It is that of the recorded publishers if all offered the same, otherwise reliable and volatile.
    Bags do not store the depth. It is 1000, or for latched topics at most the number of messages.

    Source: ``Rosbag2QoS::adapt_offer_to_recorded_offers`` of rosbag2.
    """
    profile = QoSProfile(depth=_DEPTH)
    kinds = {(offer.reliability.name, offer.durability.name) for offer in offers}
    reliability, durability = kinds.pop() if len(kinds) == 1 else ("", "")
    if reliability == "BEST_EFFORT":
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if durability == "TRANSIENT_LOCAL":
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        profile.depth = min(max(count, 1), _DEPTH)
    return profile


@contextmanager
def replaying(bag: Path, selection: TopicSelection, namespace: str) -> Iterator[Replay]:
    """Open a bag for replay by its own node, without signal handlers.

    Raises:
        BagError: If the bag cannot be replayed.
    """
    with (
        open_bag(bag) as reader,
        ros_context() as context,
        graph_node(context, "replay", "") as node,
    ):
        yield Replay(node, reader, selection, namespace)
