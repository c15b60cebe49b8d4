# SPDX-License-Identifier: Apache-2.0
"""Recording from inside the process of a hand: its messages are noted, and written elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.nodes.recorder.raw_topic import RawTopic, Tapped
from tactile_hand_ros.nodes.recorder.recording import Recording
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.direct.publisher import DirectPublisher


class SharedRecording(Recording):
    """Takes the bytes of publishers in its process from them, and those of others from DDS.

    A tick pays for noting its messages. When all nodes have answered, `rest` puts them into the
    pipe of a `WriterProcess`, whose bag is that of a `Recording`.
    """

    calm_after = 0.5  # a look takes longer than a tick
    _writer: WriterProcess

    def _begin(self, **options: Any) -> WriterProcess:
        self._tapped: list[Tapped] = []
        writer = WriterProcess()
        writer.begin(**options)
        return writer

    def check_ready(self) -> None:
        """Wait until the bag is there.

        Raises:
            BagError: If it cannot be created.
        """
        self._writer.check()

    def meet(self, publisher: DirectPublisher) -> None:
        """Take all messages of a publisher of this process, from the first one on."""
        kind = publisher.msg_type
        package, name = kind.__module__.partition(".")[0], kind.__name__
        if publisher.topic_name not in self._topics:
            self._consider(publisher.topic_name, f"{package}/msg/{name}")

    def rest(self) -> None:
        """Hand over what the publishers of this process have sent.

        Raises:
            BagError: If the process that writes has ended.
        """
        if self._tapped:
            self._write_tapped()
            self._writer.send()

    def end(self) -> None:
        """Take no more messages."""
        for topic in self._topics.values():
            topic.end()
        self._topics.clear()

    def _write_tapped(self) -> None:
        for topic, data, sent in self._tapped:
            self._write(topic, data, sent, sent)
        self._tapped.clear()

    def _drain(self) -> int:
        """Write what publishers of other processes have sent."""
        self._write_tapped()
        remote = [topic for topic in self._topics.values() if topic.is_remote]
        return sum(topic.drain(self._write) for topic in remote)

    def _lost_of(self, topic: RawTopic) -> int:
        refused = 0 if topic.channel is None else self._writer.lost[topic.channel]
        return topic.lost + refused

    def _subscribe(
        self, name: str, type_name: str, publishers: Sequence[TopicEndpointInfo], depth: int
    ) -> RawTopic:
        return RawTopic(self._node, name, type_name, publishers, depth, self._tapped)
