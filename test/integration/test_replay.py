# SPDX-License-Identifier: Apache-2.0
"""Replay as a process of its own, over real DDS: every byte comes back, at its time."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.cli.app import main
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=1000)
COUNT = 200
SPACING = 5_000_000  # ns


class Listener:
    """Receives everything, with the time."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self.received: dict[str, list[tuple[float, bytes]]] = {}

    def listen(self, topic: str, type_: Any, qos: QoSProfile) -> None:
        """Subscribe to a topic."""
        received = self.received[topic] = []
        self.node.create_subscription(
            type_, topic, lambda data: received.append((time.monotonic(), data)), qos, raw=True
        )

    def until(self, condition: Callable[[], Any]) -> None:
        """Listen until something is so."""
        wait_until(lambda: self.executor.spin_once(timeout_sec=0.01) or condition(), 30.0)

    def numbers(self, topic: str) -> list[float]:
        """Return what was received on a topic of numbers."""
        return [deserialize_message(data, Float64).data for _, data in self.received[topic]]

    def call(self, paused: bool) -> SetBool.Response:
        """Pause or continue."""
        client = self.node.create_client(SetBool, "/replay/pause")
        self.until(client.service_is_ready)
        future = client.call_async(SetBool.Request(data=paused))
        self.until(future.done)
        response: SetBool.Response = future.result()
        return response


@pytest.fixture
def listener() -> Iterator[Listener]:
    """Return a listener in a domain of its own."""
    with isolated_domain() as domain, private_context(domain) as context:
        node = Node("listener", context=context)
        yield Listener(node)
        node.destroy_node()


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of a second."""
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        latched = offered_qos(LATCHED)
        robot = writer.add_channel("/robot_description", "std_msgs/msg/String", offers=[latched])
        values = writer.add_channel("/value", "std_msgs/msg/Float64", offers=[offered_qos(DEEP)])
        fast = offered_qos(QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
        sensor = writer.add_channel("/sensor", "std_msgs/msg/Float64", offers=[fast])
        writer.write(robot, serialize_message(String(data="<robot/>")), 10**18, 0)
        for i in range(COUNT):
            at = 10**18 + i * SPACING
            data = serialize_message(Float64(data=float(i)))
            writer.write(values, data, at, at)
            writer.write(sensor, data, at + 1, at)
    return folder


@pytest.fixture
def replay(bag: Path) -> Iterator[Callable[..., CapturedProcess]]:
    """Return a function that starts a paused replay of the bag."""
    with ExitStack() as stack:

        def start(*arguments: str) -> CapturedProcess:
            command = [sys.executable, "-m", "tactile_hand_ros.cli", "replay", bag]
            return stack.enter_context(CapturedProcess([*command, "--start-paused", *arguments]))

        yield start


def publishers_of(listener: Listener, *topics: str) -> Callable[[], bool]:
    """Return whether all topics have a publisher that the listener has met."""
    return lambda: all(listener.node.count_publishers(topic) for topic in topics)


def test_all_messages_come_in_order_and_not_before_their_time(
    replay: Callable[..., CapturedProcess], listener: Listener
) -> None:
    """Bytes, order, quality of service and pace; a slow machine can only be late."""
    listener.listen("/value", Float64, DEEP)
    listener.listen("/robot_description", String, LATCHED)
    process = replay("--rate", "2")
    listener.until(publishers_of(listener, "/value", "/robot_description", "/sensor"))
    [offer] = listener.node.get_publishers_info_by_topic("/sensor")
    assert offer.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    [offer] = listener.node.get_publishers_info_by_topic("/robot_description")
    assert offer.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    before = time.monotonic()
    assert listener.call(paused=False).success
    listener.until(lambda: len(listener.received["/value"]) == COUNT)
    assert listener.numbers("/value") == [float(i) for i in range(COUNT)]
    at, last = listener.received["/value"][-1]
    assert last == serialize_message(Float64(data=COUNT - 1.0))
    assert at - before >= 1e-9 * (COUNT - 1) * SPACING / 2.0
    assert len(listener.received["/robot_description"]) == 1
    assert process.wait() == 0
    assert f"published {2 * COUNT + 1} messages" in process.stderr


def test_pause_loop_clock_and_interrupt(
    replay: Callable[..., CapturedProcess], listener: Listener
) -> None:
    """Time stands still while paused; the loop starts again; Ctrl-C ends without a traceback."""
    listener.listen("/value", Float64, DEEP)
    listener.listen("/clock", Clock, DEEP)
    process = replay("--loop", "--clock", "--topics=/value", "--rate=4")
    listener.until(publishers_of(listener, "/value"))
    listener.call(paused=False)
    listener.until(lambda: len(listener.received["/value"]) > 20)
    listener.call(paused=True)
    clocks = len(listener.received["/clock"])
    listener.until(lambda: len(listener.received["/clock"]) > clocks + 20)
    times = [deserialize_message(data, Clock).clock for _, data in listener.received["/clock"]]
    stamps = [time.sec * 10**9 + time.nanosec for time in times]
    assert len(set(stamps[-10:])) == 1 and 10**18 < stamps[-1] < 10**18 + COUNT * SPACING
    paused_at = len(listener.received["/value"])
    assert paused_at < COUNT
    listener.call(paused=False)
    listener.until(lambda: len(listener.received["/value"]) > 2 * COUNT)
    numbers = listener.numbers("/value")
    assert numbers == [float(i % COUNT) for i in range(len(numbers))]
    process.send(signal.SIGINT)
    assert process.wait() == 130
    assert "Traceback" not in process.stderr


@pytest.mark.parametrize(
    ("argument", "text"),
    [
        ("--rate=0", "expected a number above 0"),
        ("--exclude=(", "not a valid regular expression"),
        ("--set=a=1", "expected --recompute too"),
        ("--start-offset=nan", "offset"),
        ("--namespace=1x", "is not a namespace"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(
    bag: Path, capsys: pytest.CaptureFixture[str], argument: str, text: str
) -> None:
    with isolated_domain():
        assert main(["replay", str(bag), "--start-paused", "--loop", argument]) == 2
    printed = capsys.readouterr().err
    assert text in printed and printed.count("\n") == 1
