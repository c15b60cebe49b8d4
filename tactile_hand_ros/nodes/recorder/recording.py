# SPDX-License-Identifier: Apache-2.0
"""Recording of a ROS graph: finds topics, takes their messages, writes them to a bag."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.bag.metadata import BagMetadata
from tactile_hand_ros.bag.provenance import RECORD_NAME, provenance
from tactile_hand_ros.bag.qos import OfferedQos
from tactile_hand_ros.bag.recover import continue_bag
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.bag.selection import TopicSelection
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.raw_topic import RawTopic
from tactile_hand_ros.nodes.recorder.snapshot import SnapshotBuffer
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.poll_backoff import PollBackoff

_CALM_FACTOR = 10.0  # so much rarer are the looks at a graph that does not change
QUIET = 0.05  # s without a message after which nothing more is on its way
LAST_CALL = 0.5  # s, longest wait for that when publishers go on
_ATTENTION = 0.002  # s between two visits to the queues in that time


@dataclass(frozen=True)
class RecordingStatus:
    """Counters of a recording."""

    messages: int
    size: int  # bytes of the messages
    topics: int
    lost: int
    refused: int  # topics whose type is not installed


class Recording:
    """Writes all messages of the chosen topics to a new bag, or to one that was cut off.

    Call `step` every few milliseconds and `close` at the end, while the context is still valid: a
    topic's first message needs the graph for what its publishers offer.

    Topics are subscribed as soon as the graph knows them, with or without a publisher, so that a
    publisher that appears later finds the subscription already there.

    Attributes:
        calm_after: Time after which a graph that does not change is looked at less often [s].
    """

    calm_after = 5.0

    def __init__(self, node: Node, config: RecorderConfig) -> None:
        """Create the bag.

        Args:
            node: Node that owns the subscriptions.
            config: What to record and where to.

        Raises:
            BagError: If the folder exists or cannot be written.
        """
        self._node = node
        self._config = config
        self._selection = TopicSelection(config.topics, config.exclude)
        self._topics: dict[str, RawTopic] = {}
        self._refused: set[str] = set()
        self._next_discovery = 0.0
        often = config.discovery_period
        self._attention = PollBackoff(often, _CALM_FACTOR * often, self.calm_after)
        self._next_flush = 0.0
        keeps = config.snapshot_duration
        self._buffer = SnapshotBuffer(keeps) if keeps > 0.0 else None
        self._writer: BagWriter | WriterProcess = self._begin(**self._bag(config))
        # In the metadata as rosbag2 knows it, and as a record that any MCAP reader shows.
        self._writer.add_metadata(RECORD_NAME, provenance(config.scenario))

    def _begin(self, **options: Any) -> BagWriter | WriterProcess:
        """Create the bag with the options of `BagWriter`."""
        return BagWriter(**options)

    def _bag(self, config: RecorderConfig) -> dict[str, Any]:
        """Return what the bag is to be; it continues the broken one that a recorder left."""
        broken = continue_bag(Path(config.output))
        if broken is not None:
            self._node.get_logger().warning(f"going on after a recorder died: {broken.sentence}")
        told = broken.metadata.custom_data if broken else {}
        return {
            "folder": Path(config.output),
            "compression": config.compression,
            "chunk_size": config.chunk_size,
            "custom_data": {**told, **provenance(config.scenario)},
            "max_size": config.split_size,
            "max_duration": round(config.split_duration * 1e9),
            "earlier": broken.metadata if broken else None,
            "lazy": self._buffer is not None,
        }

    def check_ready(self) -> None:
        """Make sure that the bag is there; without another process it is.

        Raises:
            BagError: If it cannot be created.
        """

    def rest(self) -> None:
        """Hand over what publishers of this process have sent; without a hand in it, nothing."""

    @property
    def folder(self) -> Path:
        """Folder of the bag."""
        return self._writer.folder

    @property
    def status(self) -> RecordingStatus:
        """Present counters."""
        return RecordingStatus(
            messages=self._writer.message_count,
            size=self._writer.bytes_received,
            topics=len(self._topics),
            lost=sum(self.lost().values()),
            refused=len(self._refused),
        )

    @property
    def is_calm(self) -> bool:
        """Whether no topic or publisher has come or gone for some time."""
        return self._attention.is_calm

    def lost(self) -> dict[str, int]:
        """Return the topics that lost messages and how many."""
        counts = {topic.name: self._lost_of(topic) for topic in self._topics.values()}
        return {name: count for name, count in counts.items() if count}

    def _lost_of(self, topic: RawTopic) -> int:
        return topic.lost

    def step(self) -> int:
        """Write what has arrived and look for topics when it is time.

        Returns:
            Number of messages written.

        Raises:
            BagError: If the disk refuses the data.
        """
        now = time.monotonic()
        if now >= self._next_discovery:
            self._next_discovery = now + self._attention.period(self._discover())
        count = self._drain()
        if now >= self._next_flush:
            self._next_flush = now + self._config.flush_period
            self._writer.flush()
        return count

    def snapshot(self) -> int:
        """Write what was kept in memory, as a whole file of a whole bag.

        Returns:
            Number of messages written.

        Raises:
            BagError: If the disk refuses the data.
        """
        assert self._buffer is not None
        self._drain()
        kept = self._buffer.take()
        for message in kept:
            self._put(*message)
        if kept:
            self._writer.checkpoint()
        return len(kept)

    def close(self) -> BagMetadata:
        """Write what is still on its way, then index and metadata.

        Returns:
            The metadata of the bag.

        Raises:
            BagError: If the disk refuses the data.
        """
        if self._writer.is_open:
            self._last_call()
            lost = self.lost()
            self._writer.custom_data["lost_messages"] = str(sum(lost.values()))
            for name, count in lost.items():
                self._writer.custom_data[f"lost_messages{name}"] = str(count)
        return self._writer.close()

    def _last_call(self) -> None:
        """Write until the topics are quiet: what was sent before the end must be in the bag."""
        pause = threading.Event()
        end = time.monotonic() + LAST_CALL
        quiet = time.monotonic() + QUIET
        while time.monotonic() < min(end, quiet):
            if self._drain():
                quiet = time.monotonic() + QUIET
            pause.wait(_ATTENTION)
        self._drain()

    def _drain(self) -> int:
        return sum(topic.drain(self._write) for topic in self._topics.values())

    def _write(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        if self._buffer is None:
            self._put(topic, data, received, sent)
        else:
            self._buffer.add(topic, data, received, sent)

    def _put(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        channel = topic.channel or self._open_channel(topic)
        self._writer.write(channel, data, received, sent)

    def _discover(self) -> bool:
        """Look for topics and publishers; return whether some came or went."""
        changed = False
        for name, types in self._node.get_topic_names_and_types():
            topic = self._topics.get(name)
            if topic is None:
                changed |= self._consider(name, types[0])
            elif self._node.count_publishers(name) != topic.publishers:
                self._adapt(topic)
                changed = True
        return changed

    def _adapt(self, topic: RawTopic) -> None:
        """React to publishers that came or went."""
        topic.adapt(self._node.get_publishers_info_by_topic(topic.name), self._write)
        if topic.channel is None and topic.publishers:
            self._open_channel(topic)

    def _consider(self, name: str, type_name: str) -> bool:
        """Subscribe to a new topic if it is wanted and its type is known; return whether it is."""
        if name in self._refused or name not in self._selection:
            return False
        publishers = self._node.get_publishers_info_by_topic(name)
        depth = self._config.queue_depth
        try:
            message_definition(type_name)
            topic = self._subscribe(name, type_name, publishers, depth)
        except BagError as error:
            self._refused.add(name)
            self._node.get_logger().error(f"{name} is not recorded: {error}")
            return False
        self._topics[name] = topic
        if publishers:
            self._open_channel(topic)
        return True

    def _subscribe(
        self, name: str, type_name: str, publishers: Sequence[TopicEndpointInfo], depth: int
    ) -> RawTopic:
        return RawTopic(self._node, name, type_name, publishers, depth)

    def _open_channel(self, topic: RawTopic) -> int:
        publishers = self._node.get_publishers_info_by_topic(topic.name)
        hashes = [str(p.topic_type_hash) for p in publishers if p.topic_type == topic.type_name]
        topic.channel = self._writer.add_channel(
            topic.name,
            topic.type_name,
            offers=[OfferedQos.from_profile(p.qos_profile) for p in publishers],
            type_hash=hashes[0] if hashes else "",
        )
        return topic.channel
