# SPDX-License-Identifier: Apache-2.0
"""Recording of a ROS graph: finds topics, takes their messages, writes them to a bag."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path

from rclpy.node import Node

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.provenance import LOST_KEY, RECORD_NAME, provenance
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.bag.selection import TopicSelection
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.topic import RawTopic, publishers_of
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.node import TickPublisher

_QUEUE_DEPTH = 5000  # messages that a topic's queue holds between two visits
_DISCOVERY_PERIOD = 0.02  # s between two looks at the graph for new topics
_CALM_PERIOD = 0.2  # s, for a graph that does not change
_CALM_AFTER = 1.0  # s
_QUIET = 0.05  # s without a message after which nothing more is on its way
_LAST_CALL = 0.5  # s, longest wait for that while publishers continue
_ATTENTION = 0.002  # s between two visits to the queues in that time


class Recording:
    """Writes all messages of the chosen topics to a new bag.

    Call `step` every few milliseconds and `close` at the end; the context may be shut down then.

    Topics are subscribed as soon as the graph has them, with or without a publisher, so that a
    publisher that appears later finds the subscription already there. Publishers of this process
    that can be tapped hand over their bytes instead.

    Attributes:
        writer: Writer of the bag; `check` raises if the bag could not be created.
        tapped: Channels of tapped publishers by topic.
        topics: Subscribed topics by name.
        refused: Topics whose type is not installed.
    """

    def __init__(
        self, node: Node, config: RecorderConfig, local_publishers: Sequence[TickPublisher] = ()
    ) -> None:
        """Start the bag.

        Args:
            node: Node that owns the subscriptions.
            config: What to record and where to.
            local_publishers: Publishers of this process to tap.
        """
        self._node = node
        self._config = config
        self._selection = TopicSelection(config.topics, config.exclude)
        self.topics: dict[str, RawTopic] = {}
        self.tapped: dict[str, int] = {}
        self.refused: set[str] = set()
        self._changed_at = time.monotonic()
        self._next_discovery = self._next_flush = 0.0
        origin = provenance(config.scenario)
        self.writer = WriterProcess(
            Path(config.output),
            compression=config.compression,
            custom_data=origin,
        )
        # In the metadata as rosbag2 knows it, and as a record that any MCAP reader shows.
        self.writer.add_metadata(RECORD_NAME, origin)
        for publisher in local_publishers:
            if publisher.topic in self._selection:
                self._tap(publisher)

    def lost(self) -> dict[str, int]:
        """Return the topics that lost messages and how many, on the way here or to the disk."""
        refused = self.writer.lost
        counts = {name: refused[channel] for name, channel in self.tapped.items()}
        for topic in self.topics.values():
            counts[topic.name] = topic.lost + refused[topic.channel or 0]
        return {name: count for name, count in counts.items() if count}

    def step(self) -> int:
        """Write what has arrived and look for topics when it is time.

        Returns:
            Number of messages taken from subscriptions.

        Raises:
            BagError: If the disk refuses the data.
        """
        now = time.monotonic()
        if now >= self._next_discovery:
            if self._discover():
                self._changed_at = now
            is_calm = now - self._changed_at >= _CALM_AFTER
            self._next_discovery = now + (_CALM_PERIOD if is_calm else _DISCOVERY_PERIOD)
        count = self._drain()
        if now >= self._next_flush:
            self._next_flush = now + self._config.flush_period
            self.writer.flush()
        self.writer.send()
        return count

    def close(self) -> None:
        """Write what is still on its way, then index and metadata.

        Raises:
            BagError: If the disk refuses the data.
        """
        if not self.writer.is_open:
            return
        self._last_call()
        lost = self.lost()
        self.writer.custom_data[LOST_KEY] = str(sum(lost.values()))
        for name, count in lost.items():
            self.writer.custom_data[LOST_KEY + name] = str(count)
        self.writer.close()

    def _last_call(self) -> None:
        """Write until the topics are quiet: what was sent before the end must be in the bag."""
        pause = threading.Event()
        end = time.monotonic() + _LAST_CALL
        quiet = time.monotonic() + _QUIET
        while time.monotonic() < min(end, quiet):
            if self._drain():
                quiet = time.monotonic() + _QUIET
            pause.wait(_ATTENTION)
        self._drain()

    def _drain(self) -> int:
        return sum(topic.drain(self._write) for topic in self.topics.values())

    def _write(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        if topic.channel is None:
            topic.channel = self._open_channel(topic.name, topic.type_name)
        self.writer.write(topic.channel, data, received, sent)

    def _tap(self, publisher: TickPublisher) -> None:
        package = publisher.kind.__module__.partition(".")[0]
        type_name = f"{package}/msg/{publisher.kind.__name__}"
        channel = self._open_channel(publisher.topic, type_name)
        self.tapped[publisher.topic] = channel
        write = self.writer.write

        def note(data: bytes) -> None:
            now = time.time_ns()
            write(channel, data, now, now)

        publisher.add_tap(note)

    def _discover(self) -> bool:
        """Look for topics and publishers; return whether some came or went."""
        changed = False
        for name, types in self._node.get_topic_names_and_types():
            topic = self.topics.get(name)
            if topic is None:
                changed |= self._consider(name, types[0])
            elif topic.adapt(self._write):
                self._announce(topic)
                changed = True
        return changed

    def _consider(self, name: str, type_name: str) -> bool:
        """Subscribe to a new topic if it is wanted and its type is known; return whether it is."""
        if name in self.refused or name in self.tapped or name not in self._selection:
            return False
        try:
            message_definition(type_name)
            topic = RawTopic(self._node, name, type_name, _QUEUE_DEPTH)
        except BagError as error:
            self.refused.add(name)
            self._node.get_logger().error(f"{name} is not recorded: {error}")
            return False
        self.topics[name] = topic
        self._announce(topic)
        return True

    def _announce(self, topic: RawTopic) -> None:
        """Open a topic's channel as soon as its publishers are known."""
        if topic.channel is None and topic.publishers:
            topic.channel = self._open_channel(topic.name, topic.type_name)

    def _open_channel(self, name: str, type_name: str) -> int:
        publishers = publishers_of(self._node, name)
        hashes = [str(p.topic_type_hash) for p in publishers if p.topic_type == type_name]
        offers = [offered_qos(p.qos_profile) for p in publishers]
        return self.writer.add_channel(name, type_name, offers, hashes[0] if hashes else "")
