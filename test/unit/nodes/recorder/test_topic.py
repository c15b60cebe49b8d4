# SPDX-License-Identifier: Apache-2.0
"""A topic is chosen by name, subscribed with its publishers' QoS, and its losses are counted."""

import sys
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64, Int64

from tactile_hand_ros.config.model import from_flat
from tactile_hand_ros.errors import BagError, ConfigurationError
from tactile_hand_ros.nodes.recorder import topic as topic_module
from tactile_hand_ros.nodes.recorder.config import RecorderConfig, TopicSelection
from tactile_hand_ros.nodes.recorder.topic import LossCounter, RawTopic, adapted_qos
from tactile_hand_ros.ros.endpoints import message_class
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
def test_all_publishers_satisfy_what_is_asked_for(offers, reliability, durability):
    profile = adapted_qos([TopicEndpointInfo(qos_profile=each) for each in offers], 17)
    assert profile.reliability == ReliabilityPolicy[reliability]
    assert profile.durability == DurabilityPolicy[durability]
    assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, 17)


class Stage:
    """A recorded topic, its publishers, and the received messages."""

    def __init__(self, listener: Node, talker: Node) -> None:
        self.talker, self.listener = talker, listener
        self.topic = RawTopic(listener, NAME, TYPE, 1000)
        self.taken: list[int] = []
        self.times: list[tuple[int, int]] = []

    def publisher(self, profile: QoSProfile, *numbers: int) -> Publisher:
        """Create a publisher that sends numbers once the listener has discovered it."""
        publisher = self.talker.create_publisher(Int64, NAME, profile)
        wait_until(lambda: self.listener.count_publishers(NAME) == 1)
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
        """Adapt until publisher and subscription have matched."""

        def matched() -> bool:
            self.step()
            return bool(publisher.get_subscription_count() == 1)

        wait_until(matched)

    def take(self, count: int) -> list[int]:
        """Return the received messages once there are so many."""

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
def stage(context: Context, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    monkeypatch.setattr(topic_module, "_DISCOVERY", 0.0)
    nodes = Node("listener", context=context), Node("talker", context=context)
    yield Stage(*nodes)
    for node in nodes:
        node.destroy_node()


def test_messages_are_taken_with_their_times(stage):
    publisher = stage.publisher(STRICT)
    stage.match(publisher)
    stage.send(publisher, 3, 4, 5)
    assert stage.take(3) == [3, 4, 5] and stage.topic.lost == 0
    assert stage.topic.publishers == 1 and stage.topic.received == 3
    assert all(0 < sent <= received for received, sent in stage.times)


@given(st.integers(1, 1000), st.sets(st.integers(1, 98), max_size=50))
def test_of_one_publisher_what_is_missing_between_two_messages_is_counted(first, gaps):
    losses = LossCounter(lambda: {b"a"}, 0.0)
    for i in range(100):
        if i not in gaps:
            losses.note(first + i)
    assert losses.count == len(gaps)


def test_of_several_publishers_nothing_is_counted_and_all_of_one_that_appears_alone():
    present = {b"a"}
    losses = LossCounter(lambda: present, 0.0)
    for now, number, count in (
        ({b"a"}, 50, 0),  # older than the subscription
        ({b"a"}, 53, 2),
        ({b"a", b"b"}, 70, 2),
        ({b"a", b"b"}, 54, 2),
        ({b"b"}, 80, 2),
        ({b"b"}, 82, 3),
        ({b"b"}, 55, 3),  # of one that has just left
        ({b"c"}, 5, 7),  # it sent four before it matched the subscription
        (set(), 9, 7),  # the context has ended
    ):
        present = now
        losses.note(number)
        assert losses.count == count


def test_a_publisher_replaced_by_a_best_effort_one_between_two_looks_is_taken(stage):
    """The number of publishers is the same as before; missed messages are counted."""
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
def test_a_latched_topic_is_subscribed_again_before_its_first_message_only(stage, has_come):
    """Later, its history would be received twice."""
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
def test_what_a_restarted_publisher_sends_before_it_is_matched_counts_as_lost(stage, early):
    """The received and lost messages add up to all that the second publisher sent."""
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


def test_a_type_name_imports_installed_interfaces_only(tmp_path, monkeypatch):
    """A bag or a network peer may name a module in the current folder."""
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
def test_what_is_no_type_name_is_refused(name):
    with pytest.raises(BagError, match="is not a type name, expected package/msg/Type") as caught:
        message_class(name)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("topic", "chosen"),
    [
        ("/left/joint_states", True),
        ("/right/joint_states", False),
        ("/left/joint_states/raw", True),
        ("/left/debug", False),
        ("/left/_hidden", False),
        ("/prefix/left/joint_states", False),
    ],
)
def test_patterns_match_the_whole_name(topic, chosen):
    assert (topic in TopicSelection(["/left/.*"], [".*/debug"])) is chosen


def test_everything_is_the_default():
    config = RecorderConfig(output="bag")
    selection = TopicSelection(config.topics, config.exclude)
    names = ["/clock", "/rosout", "/diagnostics", "/hand/tactile/contacts", "/parameter_events"]
    assert [name in selection for name in names] == 5 * [True]


@pytest.mark.parametrize("key", ["topics", "exclude"])
def test_broken_pattern_is_refused_with_its_place(key):
    with pytest.raises(ConfigurationError, match=rf"{key}.*'\(' is not a valid regular expression"):
        from_flat(RecorderConfig, {"output": "bag", key: ["("]})
