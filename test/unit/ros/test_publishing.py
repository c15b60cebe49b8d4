# SPDX-License-Identifier: Apache-2.0
"""A message is encoded once, and only if it has a subscriber; viewers receive them in batches."""

from typing import Any

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, UInt8MultiArray
from support.nodes import Process

from tactile_hand_ros import names
from tactile_hand_ros.cdr import packed, unpacked
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros.node import TickPublisher
from tactile_hand_ros.ros.relay import TickRelay, batch_by_topic


class Numbers(TickPublisher):
    """A publisher of numbers that counts what it encodes."""

    def __init__(self, here: Process) -> None:
        super().__init__(here.user, Float64, "number", self._serialize)
        self.encoded: list[float] = []

    def _serialize(self, value: float) -> bytes:
        self.encoded.append(value)
        return bytes(serialize_message(Float64(data=value)))


def subscribe(here: Process, publisher: Numbers) -> list[float]:
    received: list[float] = []
    here.user.create_subscription(Float64, "number", lambda m: received.append(m.data), 10)
    here.wait(lambda: publisher.get_subscription_count() == 1)
    return received


def test_a_message_is_encoded_once_for_all_taps_and_subscribers(here):
    publisher, tapped = Numbers(here), list[Any]()
    publisher.publish(1.0)
    publisher.repeat()
    assert publisher.encoded == []
    publisher.taps.append(tapped.append)
    publisher.taps.append(tapped.append)
    publisher.publish(2.0)
    assert publisher.encoded == [2.0]
    assert tapped == 2 * [serialize_message(Float64(data=2.0))]
    received = subscribe(here, publisher)
    publisher.publish(3.0)
    here.wait(lambda: received == [3.0])
    assert publisher.encoded == [2.0, 3.0] and len(tapped) == 4


def test_a_message_that_nobody_wanted_is_repeated_for_who_came_later(here):
    publisher = Numbers(here)
    publisher.repeat()
    publisher.publish(3.0)
    received = subscribe(here, publisher)
    publisher.repeat()
    here.wait(lambda: received == [3.0])


def test_all_messages_of_a_node_arrive_in_batches_while_somebody_listens(here):
    publisher, topic = Numbers(here), names.ticks_of("user")
    TickRelay(here.user, [publisher])
    batches = here.receive(UInt8MultiArray, topic)
    here.wait(lambda: publisher.publish(0.0) or here.messages(topic, 0), "a batch")
    sent = [float(number) for number in range(1, 40)]
    for number in sent:
        publisher.publish(number)
    expected = [serialize_message(Float64(data=number)) for number in sent]

    def all_came() -> bool:
        here.messages(topic, 0)
        read = [batch_by_topic(bytes(serialize_message(batch))) for batch in batches]
        found = [m for batch in read for m in unpacked(batch["number"])]
        return found[-len(sent) :] == expected

    here.wait(all_came, "all messages")
    here.user.destroy_subscription(here._received.pop(topic)[0])

    def is_idle() -> bool:
        publisher.encoded.clear()
        publisher.publish(0.0)
        return not publisher.encoded

    here.wait(is_idle, "the relay to stop")


def test_a_damaged_batch_is_refused() -> None:
    data = packed([b"one", b"ab", b"none", b"", b"two", b"cde"])
    whole = bytes(serialize_message(UInt8MultiArray(data=data)))
    assert batch_by_topic(whole) == {"one": b"ab", "none": b"", "two": b"cde"}
    assert batch_by_topic(whole + b"\0\0") == batch_by_topic(whole)
    for damaged in (whole[:-1], whole[:10], b"\0\0" + whole[2:], whole[:4] + b"\1" + whole[5:]):
        with pytest.raises(MessageError, match="an array of bytes"):
            batch_by_topic(damaged)
    with pytest.raises(MessageError, match="with their lengths"):
        batch_by_topic(bytes(serialize_message(UInt8MultiArray(data=data[:-1]))))
