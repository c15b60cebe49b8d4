# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag: its bytes on its topics, with its timing, for machines without rosbag2."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_namespace import validate_namespace
from rosbags.interfaces import Connection
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from tactile_hand_ros.bag.reader import iterate, open_bag
from tactile_hand_ros.bag.selection import TopicSelection
from tactile_hand_ros.cdr import clock_bytes
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.replay.options import ReplayOptions, ReplayProgress
from tactile_hand_ros.nodes.replay.timeline import Timeline
from tactile_hand_ros.ros.messages.types import message_class

CLOCK = "/clock"
_DEPTH = 1000  # messages that a publisher keeps for slow subscribers
_NO_LIMIT = 2**31 - 1  # s; bags write durations without limit as more
_LOOK = 0.1  # s between two looks at stop and progress
_LAST_CALL = Duration(seconds=1)  # longest wait for subscribers to take the last messages


class Replay:
    """Publishes the messages of a bag.

    Service: ``~/pause`` (std_srvs/SetBool): true stands still, false goes on.

    Attributes:
        topics: Names of the published topics.
        skipped: Topics that cannot be published, and why.
    """

    def __init__(self, node: Node, bag: Path, options: ReplayOptions) -> None:
        """Create the publishers.

        Args:
            node: Node that owns publishers and service; it must be spun elsewhere.
            bag: Bag folder or file.
            options: How to replay.

        Raises:
            BagError: If the bag cannot be read, no topic of it is left to publish, or it does not
                reach to the start offset.
        """
        self._node, self._options = node, options
        self._changed = threading.Condition()
        self.progress = ReplayProgress(paused=options.paused)
        self.skipped: dict[str, str] = {}
        self._publishers: dict[str, Publisher] = {}
        self._opened = open_bag(bag)
        self._reader = self._opened.__enter__()
        try:
            _check_namespace(options.namespace)
            self._connections = self._choose(bag)
            self._begin = self._reader.start_time
            self._end = self._reader.end_time
            self.progress.duration = 1e-9 * (self._end - self._begin)
            if not 0.0 <= options.start_offset <= self.progress.duration:
                raise BagError(
                    f"The start offset is {options.start_offset:g} s, expected 0 to "
                    f"{self.progress.duration:g} s, the length of the bag {bag}."
                )
        except BaseException:
            self.close()
            raise
        self._timeline = Timeline(self._start, options.rate)
        self._clock = node.create_publisher(Clock, CLOCK, 10) if options.clock > 0.0 else None
        self._next_clock = 0.0
        node.create_service(SetBool, "~/pause", self._on_pause)

    @property
    def topics(self) -> list[str]:
        """Names of the published topics."""
        return [publisher.topic_name for publisher in self._publishers.values()]

    @property
    def _start(self) -> int:
        return int(self._begin + round(1e9 * self._options.start_offset))

    def run(
        self,
        watch: Callable[[ReplayProgress], None] = lambda _: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> ReplayProgress:
        """Publish until the end, or for ever.

        Args:
            watch: Called some times a second.
            stop: Asked some times a second; true ends the replay.
        """
        self._pause_for(self._options.delay, watch, stop)
        if not self._options.paused:
            self.pause(False)
        while not stop():
            round_end = time.monotonic() + _LOOK
            self._publish_latched()
            self._timeline.jump(self._start, time.monotonic())
            if not self._pass(watch, stop) or not self._options.loop:
                break
            # What lasts no time must not be repeated as fast as the machine can.
            self._pause_for(round_end - time.monotonic(), watch, stop)
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(_LAST_CALL)
        watch(self.progress)
        return self.progress

    def pause(self, paused: bool) -> None:
        """Stand still, or go on; may be called from any thread."""
        with self._changed:
            now = time.monotonic()
            self._timeline.pause(now) if paused else self._timeline.resume(now)
            self.progress.paused = paused
            self._changed.notify_all()

    def toggle(self) -> None:
        """Pause, or go on."""
        self.pause(not self.progress.paused)

    def close(self) -> None:
        """Close the bag."""
        self._opened.__exit__(None, None, None)

    def _choose(self, bag: Path) -> list[Connection]:
        """Return the connections to publish and create their publishers."""
        selection = TopicSelection(self._options.topics, self._options.exclude)
        chosen = [c for c in self._reader.connections if c.topic in selection]
        if self._options.clock > 0.0:
            chosen = [c for c in chosen if c.topic != CLOCK]
        kept = []
        for connection in chosen:
            try:
                self._offer(connection)
                kept.append(connection)
            except BagError as error:
                self.skipped[connection.topic] = str(error)
        if not kept:
            why = "; ".join(self.skipped.values()) or "--topics and --exclude leave none"
            raise BagError(f"No topic of the bag {bag} can be published: {why}")
        if not self._reader.message_count:
            raise BagError(f"The bag {bag} has no message; there is nothing to replay.")
        return kept

    def _offer(self, connection: Connection) -> None:
        if connection.topic in self._publishers:
            return
        count = sum(c.msgcount for c in self._reader.connections if c.topic == connection.topic)
        offers = getattr(connection.ext, "offered_qos_profiles", [])
        name = self._options.namespace.rstrip("/") + connection.topic
        self._publishers[connection.topic] = self._node.create_publisher(
            message_class(connection.msgtype), name, offered_qos(offers, count)
        )

    def _publish_latched(self) -> None:
        """Publish what a late subscriber would have got where the replay begins."""
        latched = [
            c
            for c in self._connections
            if self._publishers[c.topic].qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        ]
        last: dict[str, bytes] = {}
        if self._start > self._begin:
            for connection, _, data in iterate(self._reader, latched, stop=self._start):
                last[connection.topic] = data
        for topic, data in last.items():
            self._publishers[topic].publish(data)

    def _pass(self, watch: Callable[[ReplayProgress], None], stop: Callable[[], bool]) -> bool:
        """Publish the bag once; return whether the end was reached."""
        look = 0.0
        for connection, due, data in self._messages():
            while True:
                now = time.monotonic()
                if now >= look:
                    look = now + _LOOK
                    self._note(now, watch)
                    if stop():
                        return False
                if not self._wait(due, now, look):
                    break
            self._publishers[connection.topic].publish(data)
            self.progress.messages += 1
        self._note(time.monotonic(), watch)
        return True

    def _messages(self) -> Iterator[tuple[Connection, int, bytes]]:
        for connection, log_time, data in iterate(
            self._reader, self._connections, start=self._start
        ):
            yield connection, log_time, bytes(data)

    def _wait(self, due: int, now: float, look: float) -> bool:
        """Wait for a message's time, at most until the next look; return whether to ask again."""
        tick = self._tick_clock(now)
        with self._changed:
            ahead = self._timeline.wait(due, now)
            if ahead is not None and ahead <= 0.0:
                self.progress.late = max(self.progress.late, -ahead)
                return False
            longest = min(look, tick) - now
            self._changed.wait(max(0.0, longest if ahead is None else min(ahead, longest)))
        return True

    def _tick_clock(self, now: float) -> float:
        """Publish the time when it is due; return when it is due next."""
        if self._clock is None:
            return float("inf")
        if now >= self._next_clock:
            self._next_clock = now + 1.0 / self._options.clock
            self._clock.publish(clock_bytes(self._timeline.position(now)))
        return self._next_clock

    def _note(self, now: float, watch: Callable[[ReplayProgress], None]) -> None:
        position = 1e-9 * (self._timeline.position(now) - self._begin)
        self.progress.position = min(max(position, 0.0), self.progress.duration)
        watch(self.progress)

    def _pause_for(
        self, delay: float, watch: Callable[[ReplayProgress], None], stop: Callable[[], bool]
    ) -> None:
        end = time.monotonic() + delay
        with self._changed:
            while (left := end - time.monotonic()) > 0.0 and not stop():
                self._changed.wait(min(left, _LOOK))
                watch(self.progress)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.pause(request.data)
        response.success, response.message = True, "paused" if request.data else "running"
        return response


def _check_namespace(namespace: str) -> None:
    try:
        validate_namespace(namespace or "/")
    except InvalidNamespaceException:
        raise BagError(
            f"'{namespace}' is not a namespace, expected letters, digits and underscores that do "
            "not begin with a digit, as /left."
        ) from None


def offered_qos(offers: Sequence[Any], count: int) -> QoSProfile:
    """Return the quality of service to publish with.

    That of the recorded publishers where all offered the same, otherwise reliable and volatile.
    Bags do not know how many messages a publisher kept: here 1000, or of a latched topic all.

    Args:
        offers: Profiles as rosbags gives them.
        count: Number of messages of the topic.

    Source: ``Rosbag2QoS::adapt_offer_to_recorded_offers`` of rosbag2.
    """
    profile = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_DEPTH)
    kinds = {(o.reliability.name, o.durability.name) for o in offers}
    if len(kinds) != 1:
        return profile
    offer = offers[0]
    if offer.reliability.name == "BEST_EFFORT":
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if offer.durability.name == "TRANSIENT_LOCAL":
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        profile.depth = min(max(count, 1), _DEPTH)
    for name in ("deadline", "lifespan"):
        limit = getattr(offer, name)
        if 0 < limit.sec < _NO_LIMIT or (limit.sec == 0 and limit.nsec > 0):
            setattr(profile, name, Duration(seconds=limit.sec, nanoseconds=limit.nsec))
    return profile
