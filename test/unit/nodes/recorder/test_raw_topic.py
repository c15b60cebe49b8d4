# SPDX-License-Identifier: Apache-2.0
"""A recorder asks for the most that all publishers offer, and again when that changes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Int64

from tactile_hand_ros.nodes.recorder import raw_topic
from tactile_hand_ros.nodes.recorder.raw_topic import RawTopic, adapted_qos
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until

STRICT = QoSProfile(depth=5)
EAGER = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize(
    ("offers", "reliability", "durability"),
    [
        ([], "RELIABLE", "VOLATILE"),
        ([STRICT], "RELIABLE", "VOLATILE"),
        ([EAGER], "BEST_EFFORT", "VOLATILE"),
        ([STRICT, EAGER], "BEST_EFFORT", "VOLATILE"),
        ([LATCHED], "RELIABLE", "TRANSIENT_LOCAL"),
        ([LATCHED, STRICT], "RELIABLE", "VOLATILE"),
    ],
)
def test_all_publishers_satisfy_what_is_asked_for(
    offers: list[QoSProfile], reliability: str, durability: str
) -> None:
    profile = adapted_qos([TopicEndpointInfo(qos_profile=each) for each in offers], 17)
    assert profile.reliability == ReliabilityPolicy[reliability]
    assert profile.durability == DurabilityPolicy[durability]
    assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, 17)


class Stage:
    """A recorded topic, its publishers, and what was taken."""

    def __init__(self, context: Any) -> None:
        self.node = Node("recorder", context=context, start_parameter_services=False)
        self.sent: list[Any] = []
        self.taken: list[int] = []
        self.times: list[tuple[int, int]] = []

    def publish(self, profile: QoSProfile) -> Any:
        publisher = self.node.create_publisher(Int64, "/number", profile)
        self.sent.append(publisher)
        wait_until(lambda: self.node.count_publishers("/number") == len(self.sent))
        return publisher

    def topic(self) -> RawTopic:
        publishers = self.node.get_publishers_info_by_topic("/number")
        return RawTopic(self.node, "/number", "std_msgs/msg/Int64", publishers, 50)

    def sink(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        self.taken.append(int.from_bytes(data[4:12], "little"))
        self.times.append((received, sent))

    def adapt(self, topic: RawTopic) -> None:
        topic.adapt(self.node.get_publishers_info_by_topic("/number"), self.sink)

    def drained(self, topic: RawTopic, count: int) -> None:
        got = [0]

        def come() -> bool:
            got[0] += topic.drain(self.sink)
            return got[0] >= count

        wait_until(come)
        assert got[0] == count


@pytest.fixture
def stage() -> Iterator[Stage]:
    with isolated_domain() as domain, private_context(domain) as context:
        made = Stage(context)
        yield made
        made.node.destroy_node()


def test_messages_are_counted_as_they_are_taken(stage: Stage) -> None:
    publisher = stage.publish(STRICT)
    topic = stage.topic()
    wait_until(lambda: publisher.get_subscription_count() == 1)
    assert (topic.publishers, topic.received, topic.lost) == (1, 0, 0)
    assert topic.is_remote and not topic.latched and topic.channel is None
    for number in (3, 4, 5):
        publisher.publish(Int64(data=number))
    stage.drained(topic, 3)
    assert stage.taken == [3, 4, 5] and topic.received == 3 and topic.lost == 0
    assert all(0 < sent <= received for received, sent in stage.times)
    topic.end()
    wait_until(lambda: publisher.get_subscription_count() == 0)


def test_a_topic_is_subscribed_again_only_where_messages_would_be_missed(stage: Stage) -> None:
    topic = stage.topic()
    assert topic.publishers == 0 and not topic.is_remote
    first = topic._subscription
    strict = stage.publish(STRICT)
    stage.adapt(topic)
    assert topic._subscription is first and topic.publishers == 1 and topic.is_remote
    wait_until(lambda: strict.get_subscription_count() == 1)
    strict.publish(Int64(data=1))
    assert strict.wait_for_all_acked()
    eager = stage.publish(EAGER)
    stage.adapt(topic)
    second = topic._subscription
    assert second is not first and topic.publishers == 2
    assert stage.taken == [1]  # what waited in the old one
    wait_until(lambda: eager.get_subscription_count() == 1)
    stage.adapt(topic)
    assert topic._subscription is second
    for publisher in (strict, eager):
        stage.node.destroy_publisher(publisher)
    wait_until(lambda: stage.node.count_publishers("/number") == 0)
    stage.adapt(topic)
    assert topic._subscription is second and topic.publishers == 0


@pytest.mark.parametrize("has_come", [False, True])
def test_a_latched_topic_is_subscribed_again_before_its_first_message_only(
    stage: Stage, has_come: bool
) -> None:
    topic = stage.topic()
    first = topic._subscription
    publisher = stage.publish(LATCHED)
    wait_until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Int64(data=9))
    assert publisher.wait_for_all_acked()
    if has_come:
        stage.drained(topic, 1)
    stage.adapt(topic)
    assert topic.latched is not has_come and (topic._subscription is first) is has_come
    if not has_come:
        assert stage.taken[:1] == [9]


def test_a_message_has_the_times_of_the_middleware_or_that_at_which_it_was_taken(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    topic, asked, got = stage.topic(), list[Any](), list[tuple[bytes, int, int]]()

    def taken(subscription: Any, limit: int) -> Iterator[tuple[bytes, dict[str, Any]]]:
        asked.append((subscription, limit))
        for data, number, received, sent in ((b"a", 5, 9, 8), (b"b", None, 9, 0), (b"c", 7, 0, 0)):
            times = {"received_timestamp": received, "source_timestamp": sent}
            yield data, {"publication_sequence_number": number, **times}

    monkeypatch.setattr(raw_topic, "taken", taken)
    began = time.time_ns()
    assert topic.drain(lambda _, *what: got.append(what)) == 3
    assert asked == [(topic._subscription, topic._qos.depth)] and topic.received == 3
    assert got[:2] == [(b"a", 9, 8), (b"b", 9, 9)]
    data, received, sent = got[2]
    assert data == b"c" and began <= received == sent <= time.time_ns()
    assert topic.lost == 1  # the 6


def test_a_subscription_has_no_events_of_its_own(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By default rclpy would log each publisher whose quality of service does not fit."""
    asked: list[dict[str, Any]] = []
    made = raw_topic.SubscriptionEventCallbacks
    monkeypatch.setattr(
        raw_topic,
        "SubscriptionEventCallbacks",
        lambda **options: asked.append(options) or made(**options),
    )
    stage.topic()
    assert asked == [{"use_default_callbacks": False}]
