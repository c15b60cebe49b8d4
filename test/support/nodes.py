# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of the test, and a user that sends and receives."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message

from bench.processes import isolated_domain
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import subscribe_directly, taken
from tactile_hand_ros.ros.executor import WaitSetExecutor
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import wait_until


class Process:
    """A context with nodes that run while the test waits."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.user = Node("user", context=context)
        self._executor = WaitSetExecutor(context=context)
        self._nodes: list[Any] = [self.user]
        self._received: dict[str, tuple[Any, list[Any]]] = {}
        self._executor.add_node(self.user)

    def add(self, *nodes: Any) -> None:
        """Serve nodes until the end."""
        for node in nodes:
            self._nodes.append(node)
            self._executor.add_node(node)

    def make(self, kind: Callable[..., Any], *, composed: bool = True, **parameters: Any) -> Any:
        """Create and serve a node of a chain with parameters, by default without inputs."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.add(kind(composed=composed, context=self.context, parameter_overrides=overrides))
        return self._nodes[-1]

    def wait(self, condition: Callable[[], Any], message: str = "") -> Any:
        """Run the nodes until a condition holds."""

        def served() -> Any:
            self._executor.spin_once(0.0)
            return condition()

        return wait_until(served, 60.0, message)

    def receive(self, kind: Any, topic: str, profile: Any = qos.USER_DEPTH) -> list[Any]:
        """Subscribe and return the list that will hold the messages, see `messages`."""
        subscription = subscribe_directly(self.user, kind, topic, profile)
        found: list[Any] = []
        self._received[topic] = subscription, found
        self.wait(lambda: subscription.get_publisher_count() > 0, topic)
        return found

    def messages(self, topic: str, count: int) -> list[Any]:
        """Wait for a number of messages of a topic and return all received ones."""
        subscription, found = self._received[topic]

        def enough() -> bool:
            for data, _ in taken(subscription):
                found.append(deserialize_message(data, subscription.msg_type))
            return len(found) >= count

        self.wait(enough, f"{count} of {topic}, got {len(found)}")
        return found

    def send(self, topic: str, message: Any, profile: Any = qos.USER_DEPTH) -> None:
        """Publish a message once there are subscribers."""
        publisher = self.user.create_publisher(type(message), topic, profile)
        self.wait(lambda: publisher.get_subscription_count() > 0, topic)
        publisher.publish(message)

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """Call a service and return its answer."""
        client = self.user.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(kind.Request(**fields))
        self.wait(future.done, name)
        return future.result()

    def close(self) -> None:
        """Destroy all nodes."""
        for node in reversed(self._nodes):
            self._executor.remove_node(node)
            getattr(node, "close", lambda: None)()
            node.destroy_node()
        self._executor.shutdown()


@contextmanager
def process() -> Iterator[Process]:
    """Provide a process in its own ROS domain."""
    with isolated_domain() as domain, ros_context(domain=domain) as context:
        made = Process(context)
        try:
            yield made
        finally:
            made.close()


@contextmanager
def spinning(*nodes: Node) -> Iterator[None]:
    """Serve nodes in a thread that is joined at the end; raise its exceptions here."""
    executor = WaitSetExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    with ThreadPoolExecutor(1) as pool:
        served = pool.submit(executor.spin)
        try:
            yield
        finally:
            executor.shutdown()
            served.result()


def tapped(node: Any) -> dict[str, list[bytes]]:
    """Return the lists that collect a node's messages at each tick, by relative topic."""
    sent: dict[str, list[bytes]] = {}
    for publisher in node.tick_publishers:
        publisher.taps.append(sent.setdefault(publisher.topic.lstrip("/"), []).append)
    return sent


def facts(node: Any) -> dict[str, str]:
    """Return the diagnostics of a node."""
    node.on_report()
    return {pair.key: pair.value for pair in node.diagnostics.status().values}


def counts(node: Any, kind: str) -> dict[str, int]:
    """Return a node's number of errors, or of rejected messages, by source."""
    start = f"{kind} "
    told = facts(node).items()
    return {key.removeprefix(start): int(n) for key, n in told if key.startswith(start)}
