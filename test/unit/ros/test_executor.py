# SPDX-License-Identifier: Apache-2.0
"""What the executor does with errors, turns and work, over real DDS, without a thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, Int8
from std_srvs.srv import Trigger

from tactile_hand_ros.ros.endpoints import subscribe_directly
from tactile_hand_ros.ros.executor import WaitSetExecutor, spin
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.ros.qos import user_qos

GARBAGE = serialize_message(Int8(data=1))
"""Too short for a Float64."""


class Survivor(Node):
    """A node that notes what it survives."""

    def __init__(self, name: str, context: Any) -> None:
        super().__init__(name, context=context, start_parameter_services=False)
        self.survived: list[tuple[str, str]] = []

    def survive(self, source: str, error: Exception) -> None:
        self.survived.append((source, str(error)))


@pytest.fixture
def context() -> Iterator[Any]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


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
    """Spin until a condition holds; a timer looks for it."""
    executor = WaitSetExecutor(context=nodes[0].context)

    def look() -> None:
        if condition():
            executor.shutdown(timeout_sec=0)

    nodes[-1].create_timer(0.002, look)
    spin(nodes, executor)
    assert executor.get_nodes() == []


@pytest.mark.parametrize("spun", [True, False])
def test_after_a_message_of_damaged_bytes_the_next_is_received(
    nodes: list[Any], spun: bool
) -> None:
    got: list[float] = []
    nodes[1].create_subscription(Float64, "x", lambda m: got.append(m.data), 10)
    publish(nodes[2], "x", GARBAGE, Float64(data=2.0))
    if spun:
        spin_until(nodes, lambda: got)
    else:
        executor = WaitSetExecutor(context=nodes[0].context)
        executor.add_node(nodes[1])
        wait_until(lambda: executor.spin_once(0.0) or got)
        executor.remove_node(nodes[1])
        executor.shutdown()
    assert got == [2.0]


def test_an_error_in_a_service_is_reported_by_every_node_that_survives(nodes: list[Any]) -> None:
    nodes[2].create_service(Trigger, "s", lambda *_: {}["left"])
    client = nodes[2].create_client(Trigger, "s")
    assert client.wait_for_service(10.0)
    client.call_async(Trigger.Request())
    spin_until(nodes, lambda: nodes[0].survived and nodes[1].survived)
    assert nodes[0].survived == nodes[1].survived == [("services", "'left'")]


def test_an_error_in_a_service_that_no_node_survives_ends_the_loop(nodes: list[Any]) -> None:
    nodes[2].create_service(Trigger, "s", lambda *_: {}["left"])
    client = nodes[2].create_client(Trigger, "s")
    assert client.wait_for_service(10.0)
    client.call_async(Trigger.Request())
    with pytest.raises(KeyError, match="left"):
        spin(nodes[2])


def test_a_callback_that_fails_ends_the_loop_of_a_node_that_is_not_guarded(
    nodes: list[Any],
) -> None:
    nodes[2].create_timer(0.001, lambda: {}["left"])
    with pytest.raises(KeyError, match="left"):
        spin(nodes[2])


def test_a_flood_leaves_the_other_topics_their_turn(nodes: list[Any]) -> None:
    order: list[str] = []
    for name in ("flood", "few"):
        nodes[0].create_subscription(Float64, name, lambda _, name=name: order.append(name), 300)
    publish(nodes[1], "flood", *[Float64()] * 250)
    publish(nodes[1], "few", Float64())
    spin_until(nodes, lambda: len(order) == 251)
    assert order.index("few") in (0, 100)


def test_what_waits_for_the_end_of_reading_is_called_once_after_all_messages(
    nodes: list[Any],
) -> None:
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
    spin(nodes[0], executor)
    assert calls == [0.0, 1.0, 2.0, "read"]


def test_nodes_work_between_messages_as_long_as_there_is_something_to_do(
    nodes: list[Any],
) -> None:
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


def test_no_executor_serves_what_is_taken_directly(nodes: list[Any]) -> None:
    taken_directly = subscribe_directly(nodes[0], Float64, "x", user_qos())
    executor = WaitSetExecutor(context=nodes[0].context)
    assert not executor.can_execute(taken_directly)
    executor.shutdown()
