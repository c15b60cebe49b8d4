# SPDX-License-Identifier: Apache-2.0
"""The recorder: everything that is said in the graph, as raw bytes, in a rosbag2 folder."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.signals import uninstall_signal_handlers
from std_srvs.srv import Trigger

from tactile_hand_ros.errors import BagError, counted
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.recording import Recording
from tactile_hand_ros.nodes.recorder.shared_recording import SharedRecording
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.direct.delivery import direct_delivery
from tactile_hand_ros.ros.node import TactileNode, set_period
from tactile_hand_ros.ros.runner import run_node
from tactile_hand_ros.ros.scheduling import use_batch_scheduling

_REST = 0.1  # s between two visits to the queues when next to nothing comes
_FEW = 10  # messages of a visit that are next to nothing, such as the diagnostics of some nodes


class RecorderNode(TactileNode[RecorderConfig]):
    """Records the chosen topics as a rosbag2 folder until it is stopped.

    Subscriptions: every topic that `topics` includes and `exclude` does not, raw, with the
    quality of service that its publishers offer. Hidden topics are left out.

    Publications: `/diagnostics` (diagnostic_msgs/DiagnosticArray), 1 Hz: messages and bytes
    recorded, number of topics, messages lost on the way, topics whose type is not installed.

    Service: with `snapshot_duration` > 0, `~/snapshot` (std_srvs/Trigger) writes the last seconds.

    Parameters: the fields of `RecorderConfig`; `output` is required.
    """

    fatal = (BagError,)  # a recorder that cannot write has nothing left to do

    def __init__(self, is_over: Callable[[], bool] = lambda: False, **kwargs: Any) -> None:
        """Create the bag and begin.

        Args:
            is_over: Asked again and again; then the node finishes the bag and ends its context.
            **kwargs: For `rclpy.node.Node`.

        Raises:
            ConfigurationError: If a parameter is refused.
            BagError: If the output exists or cannot be written.
        """
        super().__init__("recorder", RecorderConfig, **kwargs)
        self._is_over = is_over
        self._failure: BagError | None = None
        direct = direct_delivery(self.context)
        if direct is None:
            self._recording = Recording(self, self.config)
        else:
            self._recording = shared = SharedRecording(self, self.config)
            shared.step()
            direct.when_published(shared.meet)
            direct.when_at_rest(self._on_rest)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self._visits = self.create_timer(self.config.drain_period, self._on_visit, clock=steady)
        if self.config.snapshot_duration > 0.0:
            self.create_service(Trigger, "~/snapshot", self._on_snapshot)

    def close(self) -> None:
        """Write what is still on its way, then index and metadata.

        Raises:
            BagError: If the bag is not whole.
        """
        if self._failure is not None:
            raise self._failure
        self._recording.close()

    def publish_diagnostics(self) -> None:
        """Publish the counters of the recording."""
        status = self._recording.status
        self.diagnostics.value("output", self._recording.folder)
        self.diagnostics.value("messages", status.messages)
        self.diagnostics.value("bytes", status.size)
        self.diagnostics.value("topics", status.topics)
        self._warn("lost_messages", status.lost, "messages were lost before they were recorded")
        self._warn("refused_topics", status.refused, "topics have a type that is not installed")
        super().publish_diagnostics()

    def _warn(self, key: str, count: int, text: str) -> None:
        self.diagnostics.value(key, count)
        if count:
            self.diagnostics.fault(key, f"{count} {text}", WARN)

    def _on_visit(self) -> None:
        if self._is_over():
            self.close()
            self.context.try_shutdown()
            return
        try:
            came = self._recording.step()
        except BagError as error:
            self._give_up(error)
            return
        if came:
            self.diagnostics.tick()
        # The queues hold what comes in the meantime, with the time at which it came.
        is_idle = came < _FEW and self._recording.is_calm
        set_period(self._visits, _REST if is_idle else self.config.drain_period)

    def _on_rest(self) -> None:
        try:
            self._recording.rest()
        except BagError as error:
            self._give_up(error)

    def _give_up(self, error: BagError) -> None:
        """Stop recording, while a hand in the same process goes on.

        Raises:
            BagError: The error, where there is nothing else in the process.
        """
        if not isinstance(self._recording, SharedRecording):
            raise error
        if self._failure is None:
            self._failure = error
            self._visits.cancel()
            self._recording.end()
            self.diagnostics.fault("recording", str(error))
            self.get_logger().error(str(error))
            self.publish_diagnostics()

    def check_ready(self) -> None:
        """Check the parameters, and that the bag is there.

        Raises:
            ConfigurationError: If a QoS override names a topic that the node does not take.
            BagError: If the bag cannot be created.
        """
        super().check_ready()
        self._recording.check_ready()

    def _on_snapshot(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            count = self._recording.snapshot()
        except BagError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = f"{counted(count, 'message')} went to {self._recording.folder}"
        return response


def _node_that_ends_with_a_signal() -> RecorderNode:
    """Make a recorder that finishes its bag while the graph can still be asked.

    rclpy's own handlers would end the context first, and with it the access to what the
    publishers of the last messages offer.
    """
    came: list[int] = []
    uninstall_signal_handlers()
    for number in (signal.SIGINT, signal.SIGTERM):
        # No event: its lock, taken in a handler that a second signal interrupts, never comes free.
        signal.signal(number, lambda which, _: came.append(which))
    return RecorderNode(lambda: bool(came))


_node_that_ends_with_a_signal.__doc__ = RecorderNode.__doc__  # shown by --help


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder until SIGINT or SIGTERM and return the exit code."""
    use_batch_scheduling()  # its queues are long; the hand's are not
    return run_node(_node_that_ends_with_a_signal, args)


if __name__ == "__main__":
    sys.exit(main())
