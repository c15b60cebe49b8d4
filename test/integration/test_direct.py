# SPDX-License-Identifier: Apache-2.0
"""Nodes of one process hand messages to each other, and meet those of others over real DDS."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64
from support.graph import Graph
from support.spinning import spinning

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.ros.direct.delivery import deliver_directly, direct_delivery
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS, TactileNode
from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until
from tactile_hand_ros.scenario.scenario import NODES, Scenario, load_scenario

SHORT = QoSProfile(depth=3)
LATCHED = QoSProfile(depth=2, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT)


def encoded(value: float) -> bytes:
    return bytes(serialize_message(Float64(data=float(value))))


def decoded(data: bytes) -> float:
    return float(deserialize_message(data, Float64).data)


class Member(TactileNode[Config]):
    """A node without parameters."""

    def __init__(self, name: str, context: Context) -> None:
        super().__init__(name, Config, context=context)
        self.got: list[float] = []

    def keep(self, topic: str, profile: QoSProfile) -> None:
        self.subscribe(Float64, topic, self._note, profile=profile, raw=True)

    def _note(self, data: bytes) -> None:
        self.got.append(decoded(data))


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    """Reserve a ROS domain."""
    with isolated_domain() as number:
        yield number


@pytest.fixture
def context(domain: int) -> Iterator[Context]:
    """Provide a context whose nodes deliver directly.

    DDS matches its endpoints all the same, as it reads its profile once in a process: so these
    tests look at what was delivered directly only, before anything spins.
    """
    with private_context(domain) as own:
        deliver_directly(own)
        yield own


@pytest.fixture
def member(context: Context) -> Iterator[Callable[[str], Member]]:
    """Return a function that makes nodes of one process."""
    members: list[Member] = []

    def make(name: str) -> Member:
        members.append(Member(name, context))
        return members[-1]

    yield make
    for each in members:
        each.destroy_node()


def deliver(context: Context) -> None:
    """Hand over until nothing waits."""
    delivery, results = direct_delivery(context), []
    assert delivery is not None
    while delivery:
        delivery.deliver(results.append)
    assert results == []


def test_messages_arrive_in_order_and_after_the_callback_that_sent_them(
    context: Context, member: Callable[[str], Member]
) -> None:
    one, two, log = member("one"), member("two"), []
    there, back = one.tick_publisher(Float64, "there"), two.tick_publisher(Float64, "back")

    def answer(data: bytes) -> None:
        log.append(f"takes {decoded(data):g}")
        back.publish(data)
        back.publish(data)
        log.append(f"leaves {decoded(data):g}")

    two.subscribe(Float64, "there", answer, raw=True)
    one.subscribe(Float64, "back", lambda data: log.append(f"hears {decoded(data):g}"), raw=True)
    for value in (1, 2):
        there.publish(encoded(value))
    assert log == []
    deliver(context)
    assert log == ["takes 1", "leaves 1", "takes 2", "leaves 2", *2 * ["hears 1"], *2 * ["hears 2"]]


def test_a_history_keeps_the_newest_messages(
    context: Context, member: Callable[[str], Member]
) -> None:
    sender, short, deep = member("sender"), member("short"), member("deep")
    short.keep("x", SHORT)
    deep.keep("x", QoSProfile(depth=50))
    publisher = sender.tick_publisher(Float64, "x")
    for value in range(8):
        publisher.publish(encoded(value))
    deliver(context)
    assert short.got == [5, 6, 7] and deep.got == list(range(8))
    publisher.publish(encoded(8))
    deliver(context)
    assert short.got == [5, 6, 7, 8]


def test_only_endpoints_that_match_meet(context: Context, member: Callable[[str], Member]) -> None:
    sender, strict, other, fair = (member(name) for name in ("sender", "strict", "other", "fair"))
    strict.keep("x", SHORT)
    other.keep("y", BEST_EFFORT)
    fair.keep("x", BEST_EFFORT)
    sender.create_publisher(Float64, "x", BEST_EFFORT).publish(encoded(1))
    deliver(context)
    assert (strict.got, other.got, fair.got) == ([], [], [1])


def test_a_latched_message_reaches_who_comes_later(
    context: Context, member: Callable[[str], Member]
) -> None:
    sender, late, volatile = member("sender"), member("late"), member("volatile")
    publisher = sender.create_publisher(Float64, "x", LATCHED)
    for value in (1, 2, 3):
        publisher.publish(Float64(data=float(value)))
    late.keep("x", LATCHED)
    volatile.keep("x", SHORT)
    publisher.publish(Float64(data=4.0))
    deliver(context)
    assert late.got == [3, 4] and volatile.got == [4]


def test_objects_and_message_info_are_given_to_callbacks_that_want_them(
    context: Context, member: Callable[[str], Member]
) -> None:
    sender, taker, got = member("sender"), member("taker"), []
    taker.create_subscription(Float64, "x", lambda message: got.append(message.data), 10)
    taker.create_subscription(
        Float64, "x", lambda message, info: got.append(info["source_timestamp"]), 10
    )
    sender.create_publisher(Float64, "x", 10).publish(Float64(data=2.5))
    deliver(context)
    assert got[0] == 2.5 and got[1] > 0


def test_a_destroyed_subscription_gets_nothing_more(
    context: Context, member: Callable[[str], Member]
) -> None:
    sender, taker, got = member("sender"), member("taker"), []

    def once(data: bytes) -> None:
        got.append(decoded(data))
        taker.destroy_subscription(subscription)

    subscription = taker.subscribe(Float64, "x", once, raw=True)
    publisher = sender.tick_publisher(Float64, "x")
    for value in (1, 2, 3):
        publisher.publish(encoded(value))
    deliver(context)
    assert got == [1]


def test_both_ends_count_each_other(member: Callable[[str], Member]) -> None:
    sender, taker = member("sender"), member("taker")
    outside = 1  # DDS matches them here, too
    publisher = sender.tick_publisher(Float64, "x")
    taker.keep("x", SHORT)
    wait_until(lambda: publisher.get_subscription_count() == 1 + outside)
    wait_until(lambda: taker.peers()[f"{SUBSCRIPTIONS} /x"] == 1 + outside)
    assert sender.peers()[f"{PUBLICATIONS} /x"] == 1 + outside


def test_only_what_another_thread_publishes_wakes_the_executor(
    context: Context, member: Callable[[str], Member]
) -> None:
    sender, taker, wakes = member("sender"), member("taker"), []
    taker.keep("x", SHORT)
    publisher = sender.tick_publisher(Float64, "x")
    delivery = direct_delivery(context)
    assert delivery is not None
    delivery.serve(lambda: wakes.append(1))
    publisher.publish(encoded(1))
    assert wakes == []
    thread = threading.Thread(target=publisher.publish, args=(encoded(2),))
    thread.start()
    thread.join()
    assert wakes == [1]
    deliver(context)
    assert taker.got == [1, 2]


PROGRAM = """
import struct, sys
from std_msgs.msg import Float64
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.runner import run_nodes

class Counter(TactileNode[Config]):
    def __init__(self):
        super().__init__("counter", Config)
        self.number = self.tick_publisher(Float64, "number")
        self.timer = self.create_timer(0.001, self.count)
        self.sent = 0
        self.ball = self.tick_publisher(Float64, "ball")
        self.subscribe(Float64, "returned_ball", self.ball.publish, raw=True)
        self.ball.publish(encoded(0))

    def count(self):
        self.sent += 1
        self.number.publish(encoded(self.sent))

class Echo(TactileNode[Config]):
    def __init__(self):
        super().__init__("echo", Config)
        self.echo = self.tick_publisher(Float64, "echo")
        self.subscribe(Float64, "number", self.take, raw=True)
        back = self.tick_publisher(Float64, "returned_ball")
        self.subscribe(Float64, "ball", back.publish, raw=True)

    def take(self, data):
        self.echo.publish(data)

def encoded(value):
    return b"\\0\\1\\0\\0" + struct.pack("<d", value)

sys.exit(run_nodes([Echo, Counter]))
"""


@pytest.fixture
def program(tmp_path: Path, domain: int) -> Iterator[CapturedProcess]:
    """Run a counter and its echo, which also pass a ball to and fro for ever, in one process."""
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    with CapturedProcess([sys.executable, str(path)]) as process:
        yield process


def test_who_listens_from_outside_gets_everything_and_outside_publishers_are_heard(
    program: CapturedProcess, domain: int
) -> None:
    """From its match on a reader misses nothing, and what it sends is answered once, not twice.

    Timers and messages from outside have their turn although the ball never rests.
    """
    numbers: list[float] = []
    echoes: list[float] = []
    with private_context(domain) as context:
        node = Node("outside", context=context)
        deep = QoSProfile(depth=5000)
        for topic, got in (("number", numbers), ("echo", echoes)):
            keep = lambda data, got=got: got.append(decoded(data))  # noqa: E731
            node.create_subscription(Float64, topic, keep, deep, raw=True)
        publisher = node.create_publisher(Float64, "number", deep)
        with spinning(node):
            wait_until(lambda: publisher.get_subscription_count() == 2, message="the echo")
            wait_until(lambda: len(numbers) > 200 and len(echoes) > 200, message="the counter")
            for value in range(-50, 0):
                publisher.publish(encoded(value))
            wait_until(lambda: echoes and min(echoes) < 0, message="an answer")
            wait_until(lambda: -1.0 in echoes, message="the last answer")
            count = len(numbers)
            wait_until(lambda: len(numbers) > count + 100, message="more of the counter")
        node.destroy_node()
    for got in (numbers, echoes):
        counted = [value for value in got if value > 0]
        assert counted == [counted[0] + i for i in range(len(counted))]  # no gap, none twice
        assert [value for value in got if value < 0] == list(range(-50, 0))


SPLIT = """
import sys
from tactile_hand_ros.nodes.composed import MEMBERS
from tactile_hand_ros.ros.runner import run_nodes

apart = sys.argv.pop(1)
sys.exit(run_nodes([each for each in MEMBERS if each.__module__.split(".")[-2] != apart]))
"""


class SplitGraph(Graph):
    """A graph of one process, but for a node that has its own."""

    def __init__(self, apart: str, scenario: Scenario, domain: int, folder: Path) -> None:
        super().__init__(scenario, domain, folder)
        self._apart = apart

    def start(self, name: str) -> CapturedProcess:
        """Start the process with the other nodes in place of the first of them."""
        process = super().start(name) if name == self._apart else self._others()
        self.processes[name] = process
        return process

    def _others(self) -> CapturedProcess:
        for process in self.processes.values():
            if process is not self.processes.get(self._apart):
                return process
        program = self._folder / "others.py"
        program.write_text(SPLIT)
        arguments = [sys.executable, str(program), self._apart, "--ros-args"]
        for name in NODES:
            if name != self._apart:
                file = self._folder / f"{name}.yaml"
                file.write_text(to_params_yaml(self.scenario.node_config(name), name))
                arguments += ["--params-file", str(file)]
        return self._stack.enter_context(CapturedProcess(arguments))


def test_a_node_may_have_its_own_process_while_the_others_share_one(tmp_path: Path) -> None:
    """The joints end where function calls end, to the bit."""
    scenario = load_scenario("paper", {"duration": 0.4, "plant.autostart": False})
    with isolated_domain() as domain, SplitGraph("slip_regulator", scenario, domain, tmp_path) as g:
        g.begin(*[target.position for target in scenario.targets])
        g.finish()
        g.wait(lambda: g.time == scenario.duration, "the last tick")
        expected = ClosedLoop(scenario).run()
        np.testing.assert_array_equal(g.newest(names.JOINT_STATES).position, expected.theta[-1])
