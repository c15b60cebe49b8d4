# SPDX-License-Identifier: Apache-2.0
"""The nodes' own loop serves everything that the public executor serves, and stops cleanly."""

import signal
import sys
import textwrap
import threading
import time

import psutil
import pytest
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from tactile_hand_ros.ros.executor import WaitSetExecutor, spin
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until


@pytest.fixture(scope="module")
def domain():
    with isolated_domain() as number:
        yield number


@pytest.fixture
def context(domain):
    with private_context(domain) as own:
        yield own


@pytest.fixture
def make_node(context):
    nodes = []

    def make(name):
        nodes.append(rclpy.create_node(name, context=context))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def spun(context):
    """Spin nodes in a thread."""
    running = []

    def start(*nodes):
        executor = WaitSetExecutor(context=context)
        thread = threading.Thread(target=spin, args=(nodes, executor))
        thread.start()
        running.append((executor, thread))
        return executor

    yield start
    for executor, thread in running:
        executor.shutdown()
        thread.join(10.0)
        assert not thread.is_alive()


def matched(publisher):
    wait_until(lambda: publisher.get_subscription_count() > 0, message="a subscription")
    return publisher


def test_all_messages_arrive_in_order(make_node, spun):
    node, got = make_node("a"), []
    node.create_subscription(Float64, "x", lambda m: got.append(m.data), 200)
    spun(node)
    publisher = matched(node.create_publisher(Float64, "x", 200))
    for index in range(150):
        publisher.publish(Float64(data=float(index)))
    wait_until(lambda: len(got) == 150, message="150 messages")
    assert got == [float(index) for index in range(150)]


def test_message_info_and_raw_bytes(make_node, spun):
    node, infos, raws = make_node("a"), [], []
    node.create_subscription(Float64, "x", lambda m, info: infos.append((m.data, info)), 10)
    node.create_subscription(Float64, "x", raws.append, 10, raw=True)
    spun(node)
    publisher = node.create_publisher(Float64, "x", 10)
    wait_until(lambda: publisher.get_subscription_count() == 2)
    publisher.publish(Float64(data=2.5))
    wait_until(lambda: infos and raws)
    assert infos[0][0] == 2.5
    assert infos[0][1]["source_timestamp"] > 0
    assert isinstance(raws[0], bytes)
    assert deserialize_message(raws[0], Float64).data == 2.5


def test_services_and_clients_work_also_under_a_flood_of_messages(make_node, spun):
    node, other = make_node("a"), make_node("b")
    node.create_service(Trigger, "s", lambda _, answer: _succeed(answer))
    count = []
    echo = node.create_publisher(Float64, "x", 10)
    node.create_subscription(Float64, "x", lambda m: (count.append(1), echo.publish(m)), 10)
    client = other.create_client(Trigger, "s")
    spun(node, other)
    assert client.wait_for_service(10.0)
    matched(echo).publish(Float64(data=1.0))
    wait_until(lambda: len(count) > 100, message="the flood")
    for _ in range(3):
        future = client.call_async(Trigger.Request())
        wait_until(future.done, message="the answer")
        assert future.result().success


def _succeed(answer):
    answer.success = True
    return answer


def test_entities_may_come_and_go_while_spinning(make_node, spun):
    node, got = make_node("a"), []
    spun(node)
    publisher = node.create_publisher(Float64, "x", 10)
    subscription = node.create_subscription(Float64, "x", lambda m: got.append(m.data), 10)
    matched(publisher).publish(Float64(data=1.0))
    wait_until(lambda: got == [1.0])
    node.destroy_subscription(subscription)
    wait_until(lambda: publisher.get_subscription_count() == 0, message="the end of it")
    publisher.publish(Float64(data=2.0))
    again = node.create_subscription(Float64, "y", lambda m: got.append(m.data), 10)
    matched(node.create_publisher(Float64, "y", 10)).publish(Float64(data=3.0))
    wait_until(lambda: got == [1.0, 3.0])
    assert again in list(node.subscriptions)


def test_a_subscription_that_its_callback_destroys_gets_no_second_message(make_node, spun):
    node, got = make_node("a"), []

    def once(message):
        got.append(message.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(Float64, "x", once, 10)
    publisher = matched(node.create_publisher(Float64, "x", 10))
    ticks = []
    node.create_timer(0.02, lambda: ticks.append(1))
    for value in (1.0, 2.0, 3.0):
        publisher.publish(Float64(data=value))
    spun(node)
    wait_until(lambda: len(ticks) > 3)
    assert got == [1.0]


def test_quality_of_service_events_are_served(make_node, spun):
    node, events = make_node("a"), []
    callbacks = SubscriptionEventCallbacks(incompatible_qos=events.append)
    node.create_subscription(Float64, "x", print, QoSProfile(depth=1), event_callbacks=callbacks)
    spun(node)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(Float64, "x", best_effort)
    wait_until(lambda: events, message="the event of incompatible quality of service")


PROGRAM = """
import sys, threading
from rclpy.node import Node
from std_msgs.msg import Float64
from tactile_hand_ros.ros.runner import run_node

class Busy(Node):
    def __init__(self):
        super().__init__("busy")
        self.echo = self.create_publisher(Float64, "x", 10)
        if "busy" in sys.argv:
            self.create_subscription(Float64, "x", self.again, 10)
            self.create_timer(0.05, lambda: self.echo.publish(Float64()))
        self.first = self.create_timer(0.01, self.started)
        print("built", flush=True)

    def started(self):
        self.destroy_timer(self.first)
        print("spinning", flush=True)

    def again(self, message):
        self.echo.publish(message)

    def close(self):
        print("closed", flush=True)

arguments = [argument for argument in sys.argv if argument not in ("busy", "idle")]
sys.exit(run_node(Busy, arguments))
"""


@pytest.fixture
def program(tmp_path, domain):
    path = tmp_path / "program.py"
    path.write_text(textwrap.dedent(PROGRAM))
    return [sys.executable, str(path)]


@pytest.mark.parametrize(
    ("number", "phase", "load"),
    [  # each pair once
        (signal.SIGINT, "built", "idle"),
        (signal.SIGINT, "spinning", "busy"),
        (signal.SIGTERM, "built", "busy"),
        (signal.SIGTERM, "spinning", "idle"),
    ],
)
def test_a_signal_ends_a_node_at_once_and_quietly(program, number, phase, load):
    with CapturedProcess([*program, load]) as process:
        process.wait_for_output(phase)
        start = time.monotonic()
        process.send(number)
        assert process.wait(5.0) == 0
        assert time.monotonic() - start < 2.0
        # The node may be about to log that it is ready; rcl then misses the context, and says so.
        known = (": ready", "publisher's context is invalid, at")
        assert [x for x in process.stderr.splitlines() if not any(k in x for k in known)] == []
        assert "closed" in process.stdout


def test_an_idle_node_uses_no_processor_time(program):
    with CapturedProcess([*program, "idle"]) as process:
        process.wait_for_output("spinning")
        watched = psutil.Process(process.pid)
        watched.cpu_percent(None)
        settled = watched.cpu_percent(0.3)
        used = watched.cpu_percent(1.5)
        assert used < 3.0, (settled, used)
