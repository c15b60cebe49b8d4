# SPDX-License-Identifier: Apache-2.0
"""The node executor serves the same entities as rclpy's, in turn, survives errors, and stops."""

import itertools
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import psutil
import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, Int8
from std_srvs.srv import Trigger

from bench.processes import CapturedProcess, isolated_domain
from tactile_hand_ros.ros.executor import WaitSetExecutor, spin
from tactile_hand_ros.ros.processes import wait_until

GARBAGE = serialize_message(Int8(data=1))
"""Too short for a Float64."""


class Survivor(Node):
    """A node that logs the errors that it survives."""

    def __init__(self, name: str, context: Any) -> None:
        super().__init__(name, context=context, start_parameter_services=False)
        self.survived: list[tuple[str, str]] = []

    def survive(self, source: str, error: Exception) -> None:
        self.survived.append((source, str(error)))


@pytest.fixture
def nodes(context: Any) -> Iterator[list[Any]]:
    made: list[Any] = [Survivor("a", context), Survivor("b", context)]
    made.append(Node("plain", context=context, start_parameter_services=False))
    yield made
    for node in made:
        node.destroy_node()


def publish(node: Node, topic: str, *messages: Any) -> None:
    publisher = node.create_publisher(Float64, topic, 300)
    wait_until(lambda: publisher.get_subscription_count() > 0)
    for message in messages:
        publisher.publish(message)
    assert publisher.wait_for_all_acked()


def spin_until(nodes: list[Any], condition: Callable[[], Any]) -> None:
    """Spin until a condition holds; a timer polls it."""
    executor = WaitSetExecutor(context=nodes[0].context)

    def look() -> None:
        if condition():
            executor.shutdown(timeout_sec=0)

    nodes[-1].create_timer(0.002, look)
    for node in nodes:
        executor.add_node(node)
    executor.spin()


def asked(node: Node, service: str) -> Any:
    """Call a service; return its future."""
    client = node.create_client(Trigger, service)
    assert client.wait_for_service(10.0)
    return client.call_async(Trigger.Request())


def test_messages_come_in_order_with_what_is_known_of_them_and_as_bytes(nodes):
    """Damaged ones are passed over."""
    got: list[float] = []
    raw: list[bytes] = []

    def note(message: Float64, info: Any) -> None:
        assert info["source_timestamp"] > 0
        got.append(message.data)

    nodes[0].create_subscription(Float64, "x", note, 200)
    nodes[0].create_subscription(Float64, "x", raw.append, 200, raw=True)
    sent = [Float64(data=float(n)) for n in range(150)]
    publish(nodes[1], "x", GARBAGE, *sent)
    spin_until(nodes, lambda: len(got) == len(raw) - 1 == len(sent))
    assert got == [message.data for message in sent]
    assert raw == [GARBAGE, *[serialize_message(message) for message in sent]]


def test_services_and_clients_work_also_under_a_flood_of_messages(nodes):
    here, there, _ = nodes
    echo = here.create_publisher(Float64, "x", 10)
    here.create_subscription(Float64, "x", echo.publish, 10)
    here.create_service(Trigger, "s", lambda *_: Trigger.Response(success=True))
    publish(there, "x", Float64())
    future = asked(there, "s")
    spin_until(nodes, future.done)
    assert future.result().success


def test_entities_may_come_and_go_while_spinning(nodes):
    """One that its own callback destroys receives no second message."""
    here, there, _ = nodes
    got: list[float] = []

    def once(message: Float64) -> None:
        got.append(message.data)
        here.destroy_subscription(first)
        here.create_subscription(Float64, "y", lambda m: got.append(m.data), 10)
        later.reset()

    def send_later() -> None:
        if second.get_subscription_count():
            second.publish(Float64(data=3.0))

    first = here.create_subscription(Float64, "x", once, 10)
    second = there.create_publisher(Float64, "y", 10)
    later = there.create_timer(0.01, send_later)
    later.cancel()
    publish(there, "x", *(Float64(data=float(n)) for n in range(3)))
    spin_until(nodes, lambda: 3.0 in got)
    assert got == [0.0, 3.0]


def test_an_error_in_a_service_is_reported_by_every_node_that_survives(nodes):
    nodes[2].create_service(Trigger, "s", lambda *_: {}["left"])
    asked(nodes[2], "s")
    spin_until(nodes, lambda: nodes[0].survived and nodes[1].survived)
    assert nodes[0].survived == nodes[1].survived == [("services", "'left'")]


def test_an_error_that_no_node_survives_ends_the_loop(nodes):
    nodes[2].create_service(Trigger, "s", lambda *_: {}["left"])
    asked(nodes[2], "s")
    with pytest.raises(KeyError, match="left"):
        spin(nodes[2:])


def test_a_flood_leaves_the_other_topics_their_turn(nodes):
    order: list[str] = []
    for name in ("flood", "few"):
        nodes[0].create_subscription(Float64, name, lambda _, name=name: order.append(name), 300)
    publish(nodes[1], "flood", *[Float64()] * 250)
    publish(nodes[1], "few", Float64())
    spin_until(nodes, lambda: len(order) == 251)
    assert order.index("few") in (0, 100)


def test_a_fast_timer_waits_for_one_slow_one_at_most(nodes):
    """However many are due at once, as the diagnostics of all nodes."""
    called: list[str] = []

    def slow() -> None:
        called.append("slow")
        threading.Event().wait(0.02)  # the fast one is due again

    timers = [node.create_timer(0.5, slow) for node in nodes for _ in range(2)]
    nodes[0].create_timer(0.005, lambda: called.append("fast"))
    spin_until(nodes, lambda: called.count("slow") == len(timers))
    first, last = called.index("slow"), len(called) - called[::-1].index("slow")
    during = called[first:last]
    assert all(pair != ("slow", "slow") for pair in itertools.pairwise(during))


def test_a_timer_that_is_always_due_leaves_a_slow_one_its_turn_within_two_periods(nodes):
    """Counted in calls of the fast one, each as long as ten of its periods."""
    called: list[str] = []

    def fast() -> None:
        called.append("fast")
        threading.Event().wait(0.01)

    nodes[0].create_timer(0.001, fast)
    nodes[1].create_timer(0.05, lambda: called.append("slow"))
    spin_until(nodes, lambda: called.count("slow") > 3)
    between = [len(list(run)) for kind, run in itertools.groupby(called) if kind == "fast"]
    assert max(between) <= 15


def test_what_waits_for_the_end_of_reading_is_called_once_after_all_messages(nodes):
    calls: list[Any] = []
    executor = WaitSetExecutor(context=nodes[0].context)

    def finish() -> None:
        calls.append("read")
        executor.shutdown(timeout_sec=0)

    def on_message(message: Float64) -> None:
        if not calls:
            executor.after_reading(finish)
        calls.append(message.data)

    nodes[0].create_subscription(Float64, "x", on_message, 10)
    publish(nodes[1], "x", *[Float64(data=float(n)) for n in range(3)])
    executor.add_node(nodes[0])
    executor.spin()
    assert calls == [0.0, 1.0, 2.0, "read"]


def test_nodes_work_between_messages_as_long_as_there_is_something_to_do(nodes):
    """A timer gets its turn meanwhile; then the executor waits."""
    counts = {"work": 0, "timer": 0}

    def work() -> bool:
        counts["work"] += 1
        return counts["work"] < 1000

    def is_done() -> bool:
        counts["timer"] += 1
        return counts["work"] >= 1000

    nodes[0].work = work
    spin_until(nodes, is_done)
    assert counts["work"] >= 1000 and counts["timer"] > 0


PROGRAM = """
import sys
from rclpy.node import Node
from std_msgs.msg import Float64
from tactile_hand_ros.ros.runner import run_node

class Busy(Node):
    def __init__(self):
        super().__init__("busy")
        echo = self.create_publisher(Float64, "x", 10)
        if "busy" in sys.argv:
            self.create_subscription(Float64, "x", echo.publish, 10)
            self.create_timer(0.05, lambda: echo.publish(Float64()))
        self.first = self.create_timer(0.01, self.started)
        print("built", flush=True)

    def started(self):
        self.destroy_timer(self.first)
        print("spinning", flush=True)

    def close(self):
        print("closed", flush=True)

arguments = [argument for argument in sys.argv if argument not in ("busy", "idle")]
sys.exit(run_node(Busy, arguments))
"""


@pytest.mark.parametrize(
    ("number", "phase", "load"),
    [
        (signal.SIGINT, "spinning", "busy"),
        (signal.SIGTERM, "built", "busy"),
        (signal.SIGTERM, "spinning", "idle"),
    ],
)
def test_a_signal_ends_a_node_quietly_and_one_that_waits_is_idle(tmp_path, number, phase, load):
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    with isolated_domain(), CapturedProcess([sys.executable, str(path), load]) as process:
        process.wait_for_output(phase)
        if load == "idle":
            watched = psutil.Process(process.pid)
            # The first moments are those of discovery.
            wait_until(lambda: watched.cpu_percent(0.5) < 3.0, 60.0, "a node that waits")
        process.send(number)
        assert process.wait() == 0
        # The node may be about to log that it is ready; rcl then reports the missing context.
        known = (": ready", "publisher's context is invalid, at")
        assert [x for x in process.stderr.splitlines() if not any(k in x for k in known)] == []
        assert "closed" in process.stdout
