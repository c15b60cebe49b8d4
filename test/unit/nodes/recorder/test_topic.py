# SPDX-License-Identifier: Apache-2.0
"""A topic is subscribed as its publishers offer it, and what is missing is counted."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64, Int64

from bench.processes import isolated_domain
from tactile_hand_ros import names
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import topic as topic_module
from tactile_hand_ros.nodes.recorder.topic import RawTopic, SequenceTracker, adapted_qos
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import wait_until

NAME, TYPE = "/number", "std_msgs/msg/Int64"
STRICT = QoSProfile(depth=1000)
EAGER = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
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
    """A recorded topic, publishers in a participant of their own, and what was taken."""

    def __init__(self, listener: Node, talker: Node) -> None:
        self.talker, self.listener = talker, listener
        self.topic = RawTopic(listener, NAME, TYPE, 1000)
        self.taken: list[int] = []
        self.times: list[tuple[int, int]] = []

    def publisher(self, profile: QoSProfile, *numbers: int, others: int = 0) -> Publisher:
        """Create a publisher that sends numbers, the listener knowing of so many others."""
        publisher = self.talker.create_publisher(Int64, NAME, profile)
        wait_until(lambda: self.listener.count_publishers(NAME) == 1 + others)
        self.send(publisher, *numbers)
        return publisher

    def send(self, publisher: Publisher, *numbers: int) -> None:
        for number in numbers:
            publisher.publish(Int64(data=number))

    def leave(self, publisher: Publisher) -> None:
        self.talker.destroy_publisher(publisher)
        wait_until(lambda: self.listener.count_publishers(NAME) == 0)

    def step(self) -> None:
        self.topic.adapt(self._keep)
        self.topic.drain(self._keep)

    def match(self, publisher: Publisher) -> None:
        """Adapt until publisher and subscription know of each other."""

        def matched() -> bool:
            self.step()
            return bool(publisher.get_subscription_count() == 1)

        wait_until(matched)

    def take(self, count: int) -> list[int]:
        """Return what was taken once there are so many."""

        def come() -> bool:
            self.step()
            return len(self.taken) + self.topic.lost >= count

        wait_until(come)
        return self.taken

    def _keep(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        assert topic is self.topic
        self.taken.append(int.from_bytes(data[4:12], "little"))
        self.times.append((received, sent))


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    monkeypatch.setattr(topic_module, "_DISCOVERY", 0.0)
    with (
        isolated_domain() as domain,
        ros_context(domain=domain) as here,
        ros_context(domain=domain) as there,
    ):
        nodes = Node("listener", context=here), Node("talker", context=there)
        yield Stage(*nodes)
        for node in nodes:
            with suppress(Exception):
                node.destroy_node()


def test_messages_are_taken_with_their_times(stage: Stage) -> None:
    publisher = stage.publisher(STRICT)
    stage.match(publisher)
    stage.send(publisher, 3, 4, 5)
    assert stage.take(3) == [3, 4, 5] and stage.topic.lost == 0
    assert stage.topic.publishers == 1 and stage.topic.received == 3
    assert all(0 < sent <= received for received, sent in stage.times)


@pytest.mark.parametrize(("shared", "lost"), [((), 2), ((NAME,), 0)])
def test_what_a_node_sends_before_it_is_found_is_a_loss_except_on_topics_of_all_nodes(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, shared: tuple[str, ...], lost: int
) -> None:
    monkeypatch.setattr(names, "OF_ALL_NODES", shared)
    publisher = stage.publisher(EAGER, 1, 2)  # the subscription asks for more until it adapts
    stage.match(publisher)
    stage.send(publisher, 3)
    assert 3 in stage.take(1 + lost)
    assert stage.topic.lost == lost


def test_a_weaker_publisher_next_to_another_is_taken_too(stage: Stage) -> None:
    strict = stage.publisher(STRICT)
    stage.match(strict)
    stage.send(strict, 1)
    assert strict.wait_for_all_acked()
    eager = stage.publisher(EAGER, others=1)
    stage.match(eager)
    stage.send(eager, 2)
    assert stage.take(2) == [1, 2]


def test_a_publisher_replaced_by_a_best_effort_one_between_two_looks_is_taken(
    stage: Stage,
) -> None:
    """The number of publishers is the same as before; what was missed is counted."""
    strict = stage.publisher(STRICT)
    stage.match(strict)
    stage.send(strict, 1)
    stage.take(1)
    stage.leave(strict)
    eager = stage.publisher(EAGER, 2, 3, 4)  # there is no subscription
    stage.match(eager)
    stage.send(eager, 5)
    assert stage.take(5) == [1, 5] and stage.topic.lost == 3


@pytest.mark.parametrize("has_come", [False, True])
def test_a_latched_topic_is_subscribed_again_before_its_first_message_only(
    stage: Stage, has_come: bool
) -> None:
    """Later its history would come twice."""
    publisher = stage.publisher(LATCHED)
    wait_until(lambda: publisher.get_subscription_count() == 1)
    stage.send(publisher, 9)
    assert publisher.wait_for_all_acked()
    if has_come:
        stage.topic.drain(stage._keep)
    stage.step()
    stage.send(publisher, 10)
    stage.take(2)
    assert stage.taken[0] == 9 and stage.taken[-1] == 10
    assert stage.topic.received == (2 if has_come else len(stage.taken))


@pytest.mark.parametrize("early", [0, 100])
def test_what_a_restarted_publisher_sends_before_it_is_matched_counts_as_lost(
    stage: Stage, early: int
) -> None:
    """Received and lost add up to all that the second publisher sent."""
    total = 0
    for sent in (20, early + 20):
        total += sent
        publisher = stage.publisher(STRICT, *range(sent - 20))
        stage.match(publisher)
        stage.send(publisher, *range(20))
        stage.take(total)
        stage.leave(publisher)
        stage.step()
    assert len(stage.taken) + stage.topic.lost == total


def test_after_the_context_has_ended_what_has_arrived_is_still_taken(stage: Stage) -> None:
    publisher = stage.publisher(STRICT)
    stage.match(publisher)
    stage.send(publisher, 1, 2)
    assert publisher.wait_for_all_acked()
    stage.listener.context.try_shutdown()
    stage.topic.drain(stage._keep)
    assert stage.taken == [1, 2]


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
    assert message_class("std_msgs/msg/Float64") is Float64


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


def lost(numbers: list[int], publishers: int = 1) -> int:
    """Return the losses that the tracker finds in a stream of numbers."""
    tracker = SequenceTracker(publishers)
    for number in numbers:
        tracker.see(number)
    return tracker.lost


@given(st.integers(1, 1000), st.sets(st.integers(1, 98), max_size=50))
def test_one_publisher_is_counted_exactly(first: int, gaps: set[int]) -> None:
    """Whatever is missing between the first and the last message counts, nothing else."""
    numbers = [first + i for i in range(100) if i not in gaps]
    assert lost(numbers) == len(gaps)


@given(st.lists(st.sampled_from("abc"), max_size=60))
def test_interleaved_publishers_without_loss_count_zero(order: list[str]) -> None:
    """Several publishers on one topic, each from its first message, in any order."""
    counts = dict.fromkeys("abc", 0)
    numbers = []
    for publisher in order:
        counts[publisher] += 1
        numbers.append(counts[publisher])
    assert lost(numbers) == 0


@pytest.mark.parametrize(
    ("numbers", "publishers", "missing"),
    [
        ([1, 2, 5, 10, 5], 1, 2 + 4),  # a number that never came is not waited for
        ([1, 2, 3, 1, 2], 1, 0),  # a restarted publisher numbers its messages from one again
        ([1, 2, 1, 5, 2, 6], 1, 2),  # the gap belongs to the publisher just below it
        ([1, 2, 7, 3, 8, 9, 4], 2, 0),  # one that published before starts anywhere, also above
        ([1, 2, 7, 3, 8, 10, 4], 2, 1),
        ([1, 2, 7, 8], 1, 4),
        ([50, 20, 51, 21], 1, 0),  # below all others
        ([50, 1, 51, 2], 1, 0),
        ([5, 6, 8, 5], 1, 1),
        ([1, 1, 2, 2, 3, 3], 1, 0),  # two that expect the same number
        ([1, 1, 2, 2, 4, 4], 1, 2),
    ],
)
def test_gaps_and_first_numbers_are_told_apart(
    numbers: list[int], publishers: int, missing: int
) -> None:
    assert lost(numbers, publishers) == missing


@pytest.mark.parametrize(
    ("publishers", "steps", "missing"),
    [
        # One that left without a message is not waited for: a gap of the one that stayed.
        (2, [1, {"present": 0}, 4], 2),
        # Of two older ones the first numbers are free, of a third one they are a gap.
        (0, [{"present": 3, "older": 2}, 70, 30], 0),
        (0, [{"present": 3, "older": 2}, 70, 30, 34, 71], 3),
        # Older ones are expected before younger ones; then a number is a gap of the nearest below.
        (0, [{"present": 1, "older": 1}, {"present": 2, "younger": 1}, 50], 0),
        (0, [{"present": 1, "older": 1}, {"present": 2, "younger": 1}, 50, 3], 2),
        (0, [{"present": 1, "older": 1}, {"present": 2, "younger": 1}, 50, 3, 100], 2 + 49),
    ],
)
def test_each_publisher_accounts_for_one_first_number(
    publishers: int, steps: list[Any], missing: int
) -> None:
    tracker = SequenceTracker(publishers)
    for step in steps:
        tracker.change(**step) if isinstance(step, dict) else tracker.see(step)
    assert tracker.lost == missing


def test_all_of_a_publisher_that_appears_later_count() -> None:
    """A restarted publisher sends immediately, but takes time to find the subscription."""
    appeared: list[int] = []
    tracker = SequenceTracker(1, lambda: tracker.change(1, younger=len(appeared)))
    for number in (50, 51, 52):
        tracker.see(number)
    appeared.append(1)
    tracker.see(187)
    appeared.clear()
    for number in (188, 190):
        tracker.see(number)
    assert tracker.lost == 187
