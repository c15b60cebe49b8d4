# SPDX-License-Identifier: Apache-2.0
"""The recorder: all messages of the graph, as raw bytes, in a rosbag2 folder."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.provenance import LOST_KEY, provenance
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder.config import RecorderConfig, TopicSelection
from tactile_hand_ros.nodes.recorder.topic import RawTopic, publishers_of
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.node import TactileNode, TickPublisher
from tactile_hand_ros.ros.qos import HEARTBEAT

_QUEUE_DEPTH = 5000  # messages that a topic's queue holds between two polls
_VISIT_PERIOD = 0.01  # s between two polls of the subscriptions
_DISCOVERY_PERIOD = 0.05  # s between two searches for new topics
_SHARED_PERIOD = 0.2  # the same if a search delays the ticks of a hand in the same process
_FLUSH_PERIOD = 0.05  # s, maximum time before a message is written to disk
_QUIET = 1.5 * HEARTBEAT  # s without a message after which all have arrived
_LAST_CALL = 0.5  # s, maximum wait for that if publishers continue
_ATTENTION = 0.002  # s between two polls during that wait


class RecorderNode(TactileNode[RecorderConfig]):
    """Records the selected topics to a rosbag2 folder until it is stopped.

    Subscriptions: every topic that matches `topics` and not `exclude`, raw, with the quality of
    service that its publishers offer. Hidden topics are excluded. Topics are subscribed as soon as
    they are in the graph, even without a publisher, so that no first message is lost.

    Publications: `/diagnostics` (diagnostic_msgs/DiagnosticArray), 1 Hz: messages and bytes
    recorded, number of topics, lost messages, topics whose type is not installed.

    Parameters: the fields of `RecorderConfig`; `output` is required.
    """

    fatal = (BagError,)  # a recorder that cannot write must stop

    def __init__(self, local_publishers: Sequence[TickPublisher] = (), **kwargs: Any) -> None:
        """Create the bag and start.

        The publishers are those of a hand in the same process. They are recorded without a
        subscription, and that hand continues if the bag cannot be written.

        Raises:
            BagError: If the bag cannot be created.
        """
        super().__init__("recorder", RecorderConfig, **kwargs)
        self._shares_process = bool(local_publishers)
        self._failure: BagError | None = None
        self._selection = TopicSelection(self.config.topics, self.config.exclude)
        self._topics: dict[str, RawTopic] = {}
        self._tapped: dict[str, int] = {}  # channels of publishers of this process
        self._refused: set[str] = set()
        try:
            self._writer = WriterProcess(
                Path(self.config.output),
                compression=self.config.compression,
                custom_data=provenance(self.config.scenario),
            )
        except BagError:
            self.destroy_node()
            raise
        for publisher in local_publishers:
            if publisher.topic in self._selection:
                self._tap(publisher)
        self._discover()  # now: a hand in this process starts next
        period = _SHARED_PERIOD if self._shares_process else _DISCOVERY_PERIOD
        self._work = [
            self.create_timer(period, self._discover),
            self.create_timer(_FLUSH_PERIOD, self._writer.flush),
            self.create_timer(_VISIT_PERIOD, self._on_visit),
        ]

    def close(self) -> None:
        """Write the last messages, then index and metadata; the context may already be shut down.

        Raises:
            BagError: If the bag is incomplete.
        """
        if self._failure is not None:
            raise self._failure
        writer = self._writer
        if not writer.is_open:
            return
        self._last_call()
        lost = self._lost()
        writer.custom_data[LOST_KEY] = str(sum(lost.values()))
        writer.custom_data |= {LOST_KEY + name: str(count) for name, count in lost.items()}
        writer.close()

    def on_report(self) -> None:
        """Report the counters of the recording."""
        put, writer = self.diagnostics.value, self._writer
        put("output", writer.folder)
        put("messages", writer.message_count)
        put("bytes", writer.bytes_received)
        put("topics", len(self._topics) + len(self._tapped))
        lost = sum(self._lost().values())
        self._warn("lost_messages", lost, "messages were lost before they were recorded")
        self._warn("refused_topics", len(self._refused), "topics have a type that is not installed")

    def _warn(self, key: str, count: int, text: str) -> None:
        self.diagnostics.value(key, count)
        if count:
            self.diagnostics.fault(key, f"{count} {text}", WARN)

    def _lost(self) -> dict[str, int]:
        """Return the number of messages lost in transit or at the disk, by topic, without zeros."""
        refused = self._writer.lost
        counts = {name: refused[channel] for name, channel in self._tapped.items()}
        for topic in self._topics.values():
            counts[topic.name] = topic.lost + refused[topic.channel or 0]
        return {name: count for name, count in counts.items() if count}

    def _on_visit(self) -> None:
        if self._drain():
            self.diagnostics.tick()
        try:
            self._writer.send()
        except BagError as error:
            if not self._shares_process:
                raise
            self._failure = error
            for timer in self._work:
                timer.cancel()
            self.diagnostics.fault("recording", str(error))
            self.get_logger().error(str(error))
            self.publish_diagnostics()

    def _last_call(self) -> None:
        """Write until the topics are quiet, so that the bag contains all messages sent so far."""
        pause = threading.Event()
        end = time.monotonic() + _LAST_CALL
        quiet = time.monotonic() + _QUIET
        while time.monotonic() < min(end, quiet):
            if self._drain():
                quiet = time.monotonic() + _QUIET
            pause.wait(_ATTENTION)
        self._drain()

    def _drain(self) -> int:
        return sum(topic.drain(self._write) for topic in self._topics.values())

    def _write(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        if topic.channel is None:
            topic.channel = self._open_channel(topic.name, topic.type_name)
        self._writer.write(topic.channel, data, received, sent)

    def _tap(self, publisher: TickPublisher) -> None:
        package = publisher.kind.__module__.partition(".")[0]
        type_name = f"{package}/msg/{publisher.kind.__name__}"
        channel = self._open_channel(publisher.topic, type_name)
        self._tapped[publisher.topic] = channel
        write = self._writer.write

        def note(data: bytes) -> None:
            now = time.time_ns()
            write(channel, data, now, now)

        publisher.taps.append(note)

    def _discover(self) -> None:
        for name, types in self.get_topic_names_and_types():
            topic = self._topics.get(name)
            if topic is None:
                self._consider(name, types[0])
            elif topic.adapt(self._write):
                self._announce(topic)

    def _consider(self, name: str, type_name: str) -> None:
        """Subscribe to a new topic if it is selected and its type is installed."""
        if name in self._refused or name in self._tapped or name not in self._selection:
            return
        try:
            message_definition(type_name)
            topic = RawTopic(self, name, type_name, _QUEUE_DEPTH)
        except BagError as error:
            self._refused.add(name)
            self.get_logger().error(f"{name} is not recorded: {error}")
            return
        self._topics[name] = topic
        self._announce(topic)

    def _announce(self, topic: RawTopic) -> None:
        """Open a topic's channel as soon as its publishers are known."""
        if topic.channel is None and topic.publishers:
            topic.channel = self._open_channel(topic.name, topic.type_name)

    def _open_channel(self, name: str, type_name: str) -> int:
        publishers = publishers_of(self, name)
        hashes = [str(p.topic_type_hash) for p in publishers if p.topic_type == type_name]
        offers = [offered_qos(p.qos_profile) for p in publishers]
        return self._writer.add_channel(name, type_name, offers, hashes[0] if hashes else "")
