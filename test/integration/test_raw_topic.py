# SPDX-License-Identifier: Apache-2.0
"""A raw subscription over real DDS: what it counts as lost, and what it imports."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import raw_topic
from tactile_hand_ros.nodes.recorder.raw_topic import RawTopic
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.messages.types import message_class
from tactile_hand_ros.ros.processes import wait_until

TOPIC, TYPE = "/restarted", "std_msgs/msg/Float64"


@pytest.fixture
def domain() -> Iterator[int]:
    """Reserve a ROS domain."""
    with isolated_domain() as number:
        yield number


@pytest.fixture
def listener(domain: int) -> Iterator[Node]:
    """Return a node with a participant of its own."""
    with private_context(domain) as context:
        node = Node("listener", context=context)
        yield node
        node.destroy_node()


def send(publisher: Publisher, first: int, last: int) -> None:
    """Publish numbers, the last one included."""
    for number in range(first, last + 1):
        publisher.publish(Float64(data=float(number)))


@pytest.mark.parametrize("early", [0, 100])
def test_what_a_restarted_publisher_sends_before_it_is_matched_counts_as_lost(
    domain: int, listener: Node, monkeypatch: pytest.MonkeyPatch, early: int
) -> None:
    """Received and lost add up to all that the second publisher sent."""
    monkeypatch.setattr(raw_topic, "_DISCOVERY", 0.0)
    topic = RawTopic(listener, TOPIC, TYPE, [], 1000)
    came: list[bytes] = []
    for sent in (20, early + 20):
        came.clear()
        lost = topic.lost
        with private_context(domain) as context:
            node = Node("talker", context=context)
            publisher = node.create_publisher(Float64, TOPIC, QoSProfile(depth=1000))
            send(publisher, 1, sent - 20)  # some before the subscription is matched
            wait_until(lambda: publisher.get_subscription_count() == 1)  # noqa: B023
            wait_until(lambda: listener.count_publishers(TOPIC) == 1)
            send(publisher, sent - 19, sent)

            def all_accounted_for() -> bool:
                topic.adapt(listener.get_publishers_info_by_topic(TOPIC), _keep)
                topic.drain(_keep)
                return len(came) + topic.lost - lost >= sent  # noqa: B023

            def _keep(_: RawTopic, data: bytes, received: int, published: int) -> None:
                came.append(data)

            wait_until(all_accounted_for)
            node.destroy_node()
        wait_until(lambda: listener.count_publishers(TOPIC) == 0)
        topic.adapt([], _keep)
        assert len(came) + topic.lost - lost == sent


def test_a_type_name_imports_installed_interfaces_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag or a stranger in the network may name a module that lies in the current folder."""
    module = tmp_path / "evilpkg" / "msg"
    module.mkdir(parents=True)
    (module.parent / "__init__.py").write_text("")
    (module / "__init__.py").write_text("class Foo: pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BagError, match="evilpkg/msg/Foo' is not installed"):
        message_class("evilpkg/msg/Foo")
    assert "evilpkg" not in sys.modules and "evilpkg.msg" not in sys.modules
    assert message_class(TYPE) is Float64


@pytest.mark.parametrize(
    "name",
    ["", "Foo", "std_msgs/Float64", "std_msgs/msg/", "os.path/msg/Foo", "../x/msg/Foo"]
    + ["std_msgs/msg/__name__", "std_srvs/srv/Trigger", "std_msgs/msg/Float64\n", "x" * 10_000],
)
def test_what_is_no_type_name_is_refused(name: str) -> None:
    """No import is tried."""
    with pytest.raises(BagError, match="is not a type name, expected package/msg/Type") as caught:
        message_class(name)
    assert len(str(caught.value)) < 250
