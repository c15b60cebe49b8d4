# SPDX-License-Identifier: Apache-2.0
"""A message is encoded once, and only if it has a subscriber."""

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from support.spinning import spinning

from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.node import TickPublisher
from tactile_hand_ros.ros.processes import wait_until


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    made = Node("sender", namespace="left", context=context)
    yield made
    made.destroy_node()


class Encoder:
    """Encodes numbers and counts them."""

    def __init__(self) -> None:
        self.encoded: list[float] = []

    def __call__(self, value: float) -> bytes:
        self.encoded.append(value)
        return serialize_message(Float64(data=value))


def test_nothing_is_encoded_when_nobody_wants_it(node):
    encode = Encoder()
    publisher = TickPublisher(node, Float64, "number", encode)
    publisher.publish(1.0)
    publisher.repeat()
    assert not publisher.wanted and encode.encoded == []
    facts = publisher.topic, publisher.kind, publisher.qos_profile.depth
    assert facts == ("/left/number", Float64, qos.PUBLISHED_DEPTH)


def test_a_message_is_encoded_once_for_all_taps_and_subscribers(node):
    encode, tapped, received = Encoder(), [], []
    publisher = TickPublisher(node, Float64, "number", encode)
    publisher.add_tap(tapped.append)
    publisher.add_tap(tapped.append)
    publisher.publish(1.0)
    assert publisher.wanted and encode.encoded == [1.0]
    assert tapped == 2 * [serialize_message(Float64(data=1.0))]
    node.create_subscription(Float64, "number", lambda m: received.append(m.data), 10)
    wait_until(lambda: publisher.get_subscription_count() == 1)
    with spinning(node):
        publisher.publish(2.0)
        wait_until(lambda: received == [2.0])
    assert encode.encoded == [1.0, 2.0] and len(tapped) == 4


def test_a_message_that_nobody_wanted_is_repeated_for_who_came_later(node):
    publisher, received = TickPublisher(node, Float64, "number", Encoder()), list[Any]()
    publisher.repeat()
    publisher.publish(3.0)
    node.create_subscription(Float64, "number", lambda m: received.append(m.data), 10)
    wait_until(lambda: publisher.get_subscription_count() == 1)
    with spinning(node):
        publisher.repeat()
        wait_until(lambda: received == [3.0])
