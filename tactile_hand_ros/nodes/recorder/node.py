# SPDX-License-Identifier: Apache-2.0
"""The recorder: all messages of the graph, as raw bytes, in a rosbag2 folder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.recording import Recording
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.node import SUBSCRIPTIONS, TactileNode, TickPublisher
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.scheduling import use_batch_scheduling

_VISIT_PERIOD = 0.01  # s between two visits to the queues of the subscriptions


class RecorderNode(TactileNode[RecorderConfig]):
    """Records the chosen topics as a rosbag2 folder until it is stopped.

    Subscriptions: every topic that `topics` includes and `exclude` does not, raw, with the
    quality of service that its publishers offer. Hidden topics are left out.

    Publications: `/diagnostics` (diagnostic_msgs/DiagnosticArray), 1 Hz: messages and bytes
    recorded, number of topics, messages lost on the way, topics whose type is not installed.

    Parameters: the fields of `RecorderConfig`; `output` is required.
    """

    fatal = (BagError,)  # a recorder that cannot write has nothing left to do

    def __init__(self, local_publishers: Sequence[TickPublisher] = (), **kwargs: Any) -> None:
        """Create the bag and start.

        Args:
            local_publishers: Publishers of a hand in the same process, whose messages are recorded
                without a subscription. That hand continues when the bag cannot be written.
            **kwargs: For `rclpy.node.Node`.

        Raises:
            ConfigurationError: If a parameter is refused.
        """
        super().__init__("recorder", RecorderConfig, **kwargs)
        self._shares_process = bool(local_publishers)
        self._failure: BagError | None = None
        self._recording = Recording(self, self.config, local_publishers)
        self._visits = self.create_timer(_VISIT_PERIOD, self._on_visit)

    def close(self) -> None:
        """Write what is still on its way, then index and metadata.

        Raises:
            BagError: If the bag is incomplete.
        """
        if self._failure is not None:
            raise self._failure
        self._recording.close()

    def check_ready(self) -> None:
        """Check the parameters, and that the bag is there.

        Raises:
            ConfigurationError: If a QoS override names a topic that the node does not take.
            BagError: If the bag cannot be created.
        """
        super().check_ready()
        self._recording.writer.check()

    def peers(self) -> dict[str, int]:
        """Return how many matched peers each topic has; a tapped publisher is one."""
        tapped = {f"{SUBSCRIPTIONS} {topic}": 1 for topic in self._recording.tapped}
        return super().peers() | tapped

    def on_report(self) -> None:
        """Report the counters of the recording."""
        recording, writer = self._recording, self._recording.writer
        self.diagnostics.value("output", writer.folder)
        self.diagnostics.value("messages", writer.message_count)
        self.diagnostics.value("bytes", writer.bytes_received)
        self.diagnostics.value("topics", len(recording.topics) + len(recording.tapped))
        lost = sum(recording.lost().values())
        self._warn("lost_messages", lost, "messages were lost before they were recorded")
        self._warn(
            "refused_topics", len(recording.refused), "topics have a type that is not installed"
        )

    def _warn(self, key: str, count: int, text: str) -> None:
        self.diagnostics.value(key, count)
        if count:
            self.diagnostics.fault(key, f"{count} {text}", WARN)

    def _on_visit(self) -> None:
        try:
            if self._recording.step():
                self.diagnostics.tick()
        except BagError as error:
            if not self._shares_process:
                raise
            self._failure = error
            self._visits.cancel()
            self.diagnostics.fault("recording", str(error))
            self.get_logger().error(str(error))
            self.publish_diagnostics()


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder until SIGINT or SIGTERM and return the exit code."""
    use_batch_scheduling()  # its queues are long; the hand's are not
    return run_node(RecorderNode, args)
