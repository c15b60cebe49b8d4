# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag: its bytes on its topics, with its timing, for machines without rosbag2."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from std_srvs.srv import SetBool

from tactile_hand_ros.bag.reader import iterate, open_bag
from tactile_hand_ros.bag.selection import TopicSelection
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.ros.middleware import graph_node, ros_context

_DEPTH = 1000  # messages that a publisher keeps for slow subscribers
_LOOK = 0.1  # s between two calls of `watch`
_LAST_CALL = Duration(seconds=1)  # longest wait for subscribers to take the last messages


@dataclass
class Replay:
    """Publishes the messages of a bag.

    Service: ``~/pause`` (std_srvs/SetBool): true pauses, false continues.

    Attributes:
        node: Node that owns publishers and service; its executor serves it while `run` waits.
        reader: An open bag.
        rate: Seconds of the bag per second of wall time.
        start_offset: Where to start, s after the first message.
        topics: Regular expressions, one of which matches the whole name of a chosen topic.
        exclude: Regular expressions, none of which matches it.
        namespace: Put before all names of topics.
        paused: Whether it is paused.
        skipped: Topics that cannot be published, and why.
        position: Time in the bag, s after its first message.
        messages: Number of messages published.
    """

    node: Node
    reader: AnyReader
    rate: float = 1.0
    start_offset: float = 0.0
    topics: Sequence[str] = (".*",)
    exclude: Sequence[str] = ()
    namespace: str = ""
    paused: bool = False
    skipped: dict[str, str] = field(default_factory=dict)
    position: float = 0.0
    messages: int = 0

    def __post_init__(self) -> None:
        """Create the publishers.

        Raises:
            BagError: If no topic is left to publish, or the bag does not reach to the start offset.
        """
        self.duration = 1e-9 * (self.reader.end_time - self.reader.start_time)
        if self.reader.message_count and not 0.0 <= self.start_offset <= self.duration:
            raise BagError(
                f"The start offset is {self.start_offset:g} s, expected 0 to "
                f"{self.duration:g} s, the length of the bag {self.reader.paths[0]}."
            )
        self.publishers: dict[str, Publisher] = {}
        self._create_publishers()
        self._next_look = self._wall = 0.0
        self.node.create_service(SetBool, "~/pause", self._on_pause)

    def run(self, watch: Callable[[Replay], None] = lambda _: None) -> None:
        """Publish until the end; `watch` is called ten times a second."""
        self._publish_latched()
        self.position, self._wall = self.start_offset, time.monotonic()
        for topic, log_time, data in self._messages(self.start_offset):
            self._wait(1e-9 * (log_time - self.reader.start_time), watch)
            self.publishers[topic].publish(data)
            self.messages += 1
        for publisher in self.publishers.values():
            publisher.wait_for_all_acked(_LAST_CALL)
        watch(self)

    def pause(self, paused: bool) -> None:
        """Pause or continue."""
        self._move()
        self.paused = paused

    def _create_publishers(self) -> None:
        selection = TopicSelection(self.topics, self.exclude)
        chosen = [c for c in self.reader.connections if c.topic in selection]
        for connection in chosen:
            topic = connection.topic
            if topic in self.publishers:
                continue
            count = sum(c.msgcount for c in chosen if c.topic == topic)
            profile = offered_qos(getattr(connection.ext, "offered_qos_profiles", []), count)
            try:
                kind, name = message_class(connection.msgtype), self.namespace + topic
                self.publishers[topic] = self.node.create_publisher(kind, name, profile)
            except BagError as error:
                self.skipped[topic] = str(error)
        if not self.publishers or not self.reader.message_count:
            why = "; ".join(self.skipped.values()) or "--topics and --exclude leave none"
            why = why if self.reader.message_count else "it has no message"
            raise BagError(f"No topic of the bag {self.reader.paths[0]} can be published: {why}")

    def _messages(
        self, start: float, stop: float = float("inf")
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, log time and bytes between two times in s after the first message."""
        connections = [c for c in self.reader.connections if c.topic in self.publishers]
        first, last = (
            self.reader.start_time + round(1e9 * min(t, self.duration + 1.0)) for t in (start, stop)
        )
        for connection, log_time, data in iterate(self.reader, connections, start=first, stop=last):
            yield connection.topic, log_time, bytes(data)

    def _publish_latched(self) -> None:
        """Publish what a late subscriber would have received where the replay starts."""
        if self.start_offset > 0.0:
            before = self._messages(0.0, self.start_offset)
            for topic, data in {topic: data for topic, _, data in before}.items():
                publisher = self.publishers[topic]
                if publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                    publisher.publish(data)

    def _wait(self, due: float, watch: Callable[[Replay], None]) -> None:
        """Serve the node until a time in the bag [s]."""
        while True:
            now = self._move()
            if now >= self._next_look:
                self._next_look = now + _LOOK
                self.node.executor.spin_once(0.0)
                watch(self)
            ahead = _LOOK if self.paused else (due - self.position) / self.rate
            if ahead <= 0.0:
                return
            self.node.executor.spin_once(max(0.0, min(ahead, self._next_look - now)))

    def _move(self) -> float:
        """Let the time in the bag follow the time on the wall, which is returned."""
        now = time.monotonic()
        if not self.paused:
            self.position = min(self.position + self.rate * (now - self._wall), self.duration)
        self._wall = now
        return now

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.pause(request.data)
        response.success, response.message = True, "paused" if request.data else "running"
        return response


def offered_qos(offers: Sequence[Any], count: int) -> QoSProfile:
    """Return the quality of service to publish with, from profiles as rosbags gives them.

    That of the recorded publishers where all offered the same, otherwise reliable and volatile.
    Bags do not contain the depth: here it is 1000, or of a latched topic its number of messages.

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
def replaying(bag: Path, **options: Any) -> Iterator[Replay]:
    """Open a bag for replay by a node of its own; signals are left to the caller.

    Raises:
        BagError: If the bag cannot be replayed.
    """
    with (
        open_bag(bag) as reader,
        ros_context() as context,
        graph_node(context, "replay", "") as node,
    ):
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield Replay(node, reader, **options)
        finally:
            executor.shutdown()
