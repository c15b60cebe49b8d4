# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process of its own, over real DDS: nothing is missing from the bag."""

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from geometry_msgs.msg import WrenchStamped
from mcap_ros2.reader import read_ros2_messages
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from bench.processes import CapturedProcess, start_executable
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.processes import wait_until

DEEP = QoSProfile(depth=1000)
COUNT = 800  # messages on each topic
BOUND = 2.0  # s


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    """Return a node in the reserved domain."""
    node = Node("talker", context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., CapturedProcess]]:
    """Return a function that starts recorders, which do not outlive the test."""
    with ExitStack() as stack:

        def _start(output: Path, *parameters: str) -> CapturedProcess:
            arguments = [f"output:={output}", *parameters]
            flags = [word for argument in arguments for word in ("-p", argument)]
            recorder = start_executable("recorder", "--ros-args", *flags)
            return stack.enter_context(recorder)

        yield _start


def end_well(recorder: CapturedProcess) -> None:
    """Send a signal and insist on a clean end."""
    recorder.send(signal.SIGTERM)
    assert recorder.wait() == 0, recorder.stdout + recorder.stderr


def wait_for_recorder(*publishers: Publisher) -> None:
    """Wait until all publishers have a subscriber."""
    wait_until(lambda: all(p.get_subscription_count() for p in publishers))


def at_1_khz(node: Node, publish: Callable[[int], None], count: int) -> None:
    """Call `publish` with 0, 1, ... `count` - 1 at 1 kHz."""
    sent = 0

    def on_timer() -> None:
        nonlocal sent
        publish(sent)
        sent += 1

    timer = node.create_timer(0.001, on_timer)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    while sent < count:
        executor.spin_once(timeout_sec=1.0)
    node.destroy_timer(timer)


def joint_state(i: int) -> JointState:
    """Return a message that differs from all others, also in length."""
    return JointState(name=["a"] * (i % 5), position=[float(i)] * (i % 7), effort=[0.5 * i])


def test_everything_sent_before_the_end_is_in_the_bag(start, node, tmp_path):
    joints = node.create_publisher(JointState, "left/joint_states", DEEP)
    wrench = node.create_publisher(WrenchStamped, "left/tactile/index/wrench", DEEP)
    clock = node.create_publisher(Clock, "/clock", DEEP)
    recorder = start(tmp_path / "bag", "compression:=lz4")
    wait_for_recorder(joints, wrench, clock)

    def publish(i: int) -> None:
        joints.publish(joint_state(i))
        wrench.publish(WrenchStamped())
        clock.publish(Clock())

    at_1_khz(node, publish, COUNT)
    end_well(recorder)
    summary = summarize(tmp_path / "bag")
    for topic in ("/left/joint_states", "/left/tactile/index/wrench", "/clock"):
        assert summary.counts[topic] == COUNT
    assert summary.custom_data["lost_messages"] == "0"
    raw = [m.data for m in read_messages(tmp_path / "bag", ["/left/joint_states"])]
    assert [deserialize_message(data, JointState) for data in raw] == [
        joint_state(i) for i in range(COUNT)
    ]
    expected = [0.5 * i for i in range(COUNT)]
    read = read_messages(tmp_path / "bag", ["/left/joint_states"])
    assert [m.message.effort[0] for m in read] == expected
    file = str(tmp_path / "bag" / "bag_0.mcap")
    others = read_ros2_messages(file, topics=["/left/joint_states"])
    assert [m.ros_msg.effort[0] for m in others] == expected


def test_killed_at_any_moment_it_loses_the_last_moment_at_most(start, node, tmp_path):
    """What is recovered has no gap; the bound is 0.2 s, here with room for noise.

    The chunks never fill: what is on the disk is there because its time had come.
    """
    publisher, sent = node.create_publisher(Float64, "number", DEEP), list[float]()
    bags = {life: tmp_path / str(life) for life in (0.0, 0.3, BOUND + 0.5)}
    recorders = {life: start(bag) for life, bag in bags.items()}
    wait_until(lambda: publisher.get_subscription_count() == len(bags), 60.0)
    for life, recorder in recorders.items():
        writers = psutil.Process(recorder.pid).children()
        while not sent or time.monotonic() < sent[0] + life:
            publisher.publish(Float64(data=float(len(sent))))
            sent.append(time.monotonic())
            signal.sigtimedwait([], 0.002)
        recorder.send(signal.SIGKILL)
        killed = time.monotonic()
        assert recorder.wait() == -signal.SIGKILL
        psutil.wait_procs(writers, 30.0)
        saved = sum(at < killed - BOUND for at in sent)
        with contextlib.nullcontext() if saved else contextlib.suppress(BagError):
            recovered = read_messages(recover(bags[life]).target, ["/number"])
            numbers = [message.message.data for message in recovered]
            assert numbers == [float(i) for i in range(len(numbers))] and len(numbers) >= saved
