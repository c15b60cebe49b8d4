# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process of its own, over real DDS: nothing is missing from the bag."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from support.kills import RATE, kill, talker

import tactile_hand_ros
from tactile_hand_ros.bag.reader import read_messages, read_raw, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.node import SUBSCRIPTIONS, peer_count
from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.ros.processes import (
    CapturedProcess,
    executable_path,
    start_executable,
    wait_until,
)

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
DEEP = QoSProfile(depth=1000)
COUNT = 800  # messages on each topic


@pytest.fixture
def domain() -> Iterator[int]:
    """Reserve a ROS domain."""
    with isolated_domain() as number:
        yield number


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    """Return a node in the reserved domain."""
    with private_context(domain) as context:
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


def end_well(recorder: CapturedProcess, number: int = signal.SIGINT) -> None:
    """Send a signal and insist on a clean end."""
    recorder.send(number)
    assert recorder.wait() == 0, recorder.stdout + recorder.stderr


def refusal(recorder: CapturedProcess) -> str:
    """Insist on a failing exit code without a traceback and return its message."""
    assert recorder.wait() != 0
    assert "Traceback" not in recorder.stderr
    return recorder.stderr


def wait_for_recorder(*publishers: Publisher) -> None:
    """Wait until all publishers have a subscriber."""
    wait_until(lambda: all(p.get_subscription_count() for p in publishers))


def wait_until_matched(node: Node, publishers: dict[str, int]) -> None:
    """Wait until the recorder reports so many publishers of each topic.

    That a publisher knows of the recorder is not enough where nothing is sent again.
    """
    reported: dict[str, str] = {}

    def note(message: DiagnosticArray) -> None:
        for values in _recorder_values(message):
            reported.update(values)

    subscription = node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def all_matched() -> bool:
        executor.spin_once(timeout_sec=0.1)
        return all(peer_count(reported, SUBSCRIPTIONS, t) >= n for t, n in publishers.items())

    wait_until(all_matched, 60.0, f"the recorder to match {publishers}")
    executor.shutdown()
    node.destroy_subscription(subscription)


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


@pytest.mark.parametrize(("how", "compression"), [(signal.SIGINT, "zstd"), (signal.SIGTERM, "lz4")])
def test_everything_sent_before_the_end_is_in_the_bag(
    start: Callable[..., CapturedProcess],
    node: Node,
    tmp_path: Path,
    how: signal.Signals,
    compression: str,
) -> None:
    """The signal follows the last message immediately; count, order and bytes are complete."""
    joints = node.create_publisher(JointState, "left/joint_states", DEEP)
    wrench = node.create_publisher(WrenchStamped, "left/tactile/index/wrench", DEEP)
    clock = node.create_publisher(Clock, "/clock", DEEP)
    recorder = start(tmp_path / "bag", f"compression:={compression}")
    wait_for_recorder(joints, wrench, clock)

    def publish(i: int) -> None:
        joints.publish(joint_state(i))
        wrench.publish(WrenchStamped())
        clock.publish(Clock())

    at_1_khz(node, publish, COUNT)
    end_well(recorder, how)
    summary = summarize(tmp_path / "bag")
    for topic in ("/left/joint_states", "/left/tactile/index/wrench", "/clock"):
        assert summary.counts[topic] == COUNT
    assert summary.custom_data["lost_messages"] == "0"
    raw = [m.data for m in read_raw(tmp_path / "bag", ["/left/joint_states"])]
    assert [deserialize_message(data, JointState) for data in raw] == [
        joint_state(i) for i in range(COUNT)
    ]
    expected = [0.5 * i for i in range(COUNT)]
    read = read_messages(tmp_path / "bag", ["/left/joint_states"])
    assert [m.message.effort[0] for m in read] == expected
    file = str(tmp_path / "bag" / "bag_0.mcap")
    others = read_ros2_messages(file, topics=["/left/joint_states"])
    assert [m.ros_msg.effort[0] for m in others] == expected


def test_offers_hash_and_times_are_recorded(
    start: Callable[..., CapturedProcess], node: Node, tmp_path: Path
) -> None:
    """Latched messages from before the recorder, best-effort topics, two publishers."""
    latched = node.create_publisher(String, "robot_description", LATCHED)
    latched.publish(String(data="<robot/>"))
    sensor = node.create_publisher(Float64, "sensor", SENSOR)
    mixed = (
        node.create_publisher(Float64, "mixed", SENSOR),
        node.create_publisher(Float64, "mixed", DEEP),
    )
    before = time.time_ns()
    recorder = start(tmp_path / "bag")
    wait_for_recorder(latched, sensor, *mixed)
    wait_until_matched(node, {"/sensor": 1, "/mixed": 2, "/robot_description": 1})
    for publisher in (sensor, *mixed):
        publisher.publish(Float64(data=1.5))
    end_well(recorder)
    after = time.time_ns()
    with Reader(tmp_path / "bag") as reader:
        connections = {connection.topic: connection for connection in reader.connections}
        times = [time for _, time, _ in reader.messages([connections["/sensor"]])]
    expected = {
        "/robot_description": [("RELIABLE", "TRANSIENT_LOCAL")],
        "/sensor": [("BEST_EFFORT", "VOLATILE")],
        "/mixed": [("BEST_EFFORT", "VOLATILE"), ("RELIABLE", "VOLATILE")],
    }
    for topic, offers in expected.items():
        profiles = connections[topic].ext.offered_qos_profiles
        assert sorted((p.reliability.name, p.durability.name) for p in profiles) == offers
        assert connections[topic].msgcount == (2 if topic == "/mixed" else 1)
        info = node.get_publishers_info_by_topic(topic)[0]
        assert connections[topic].digest == str(info.topic_type_hash)
    assert before <= times[0] <= after


def _recorder_values(message: DiagnosticArray) -> list[dict[str, str]]:
    return [
        {pair.key: pair.value for pair in status.values}
        for status in message.status
        if "recorder" in status.name
    ]


def test_killed_at_random_moments_nothing_but_the_last_moment_is_lost(
    domain: int, tmp_path: Path
) -> None:
    """All recovered numbers follow each other; the bound is 0.2 s, here with room for noise.

    The last recorder lives for longer than that: had it saved nothing since its start, it would be
    seen.
    """
    rng, bound = random.Random(1), 2.0
    lives = [rng.uniform(0.0, 1.0) for _ in range(3)] + [bound + 0.5]
    with talker(tmp_path / "diary"):
        for run, life in enumerate(lives):
            outcome = kill(tmp_path / str(run), tmp_path / "diary", life, bound)
            assert outcome.gaps == 0 and outcome.unsaved == 0
            assert outcome.recovered > RATE * max(0.0, life - bound)


def test_full_disk_ends_with_a_sentence_and_what_was_recorded_can_be_recovered(
    domain: int, node: Node, tmp_path: Path
) -> None:
    """A limit on the size of files stands for the disk."""
    bag = tmp_path / "bag"
    publisher = node.create_publisher(JointState, "joint_states", DEEP)
    arguments = f"--ros-args -p output:={bag} -p compression:=none"
    command = f"ulimit -f 100; exec {executable_path('recorder')} {arguments}"
    with CapturedProcess(["bash", "-c", command]) as recorder:
        wait_for_recorder(publisher)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        sent = 0
        while recorder.returncode is None and sent < 100_000:
            publisher.publish(JointState(position=[float(sent)] * 50))
            sent += 1
            executor.spin_once(timeout_sec=0.001)
        sentence = refusal(recorder)
    assert "could not be written" in sentence and "tactile-hand recover" in sentence
    recovery = recover(bag)
    values = [m.message.position[0] for m in read_messages(recovery.target, ["/joint_states"])]
    assert len(values) > 100
    assert values == [values[0] + i for i in range(len(values))]


@pytest.mark.parametrize(
    ("parameter", "complaint"),
    [
        ("topics:=['(']", "not a valid regular expression"),
        ("chunksize:=65536", "chunk_size"),
        ("output:=/", "exists already"),
    ],
)
def test_bad_parameter_is_refused(
    start: Callable[..., CapturedProcess], tmp_path: Path, parameter: str, complaint: str
) -> None:
    """The message says what is allowed, and nothing is created."""
    assert complaint in refusal(start(tmp_path / "bag", parameter))
    assert not (tmp_path / "bag").exists()


def test_bag_tells_its_scenario_and_versions(domain: int, tmp_path: Path) -> None:
    """A text of several lines comes back to the letter, from both places."""
    scenario = "name: 'odd: \"1\"'\nseed: 7\ntargets:\n- {time: 0.0}\n"
    values = RecorderConfig(output=str(tmp_path / "bag"), scenario=scenario)
    parameters = tmp_path / "recorder.yaml"
    parameters.write_text(to_params_yaml(values, "recorder"))
    with start_executable("recorder", "--ros-args", "--params-file", str(parameters)) as recorder:
        wait_until((tmp_path / "bag" / "bag_0.mcap").exists)
        end_well(recorder)
    found = summarize(tmp_path / "bag").custom_data
    assert found["scenario"] == scenario
    assert found["version_tactile_hand_ros"] == tactile_hand_ros.__version__
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert records["tactile_hand_ros"].items() <= found.items()
    assert records["tactile_hand_ros"]["scenario"] == scenario
