# SPDX-License-Identifier: Apache-2.0
"""An in-process replay: what is published, when, from which time on, and how often."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Int64

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.reader import open_bag
from tactile_hand_ros.bag.schema import MessageDefinition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.cli.app import main
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes import replay as replay_module
from tactile_hand_ros.nodes.recorder.config import TopicSelection
from tactile_hand_ros.nodes.replay import Replay

TYPE, BEGIN, STEP = "std_msgs/msg/Int64", 10**18, 10_000_000
LATCHED = offered_qos(QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
DEEP = offered_qos(QoSProfile(depth=1))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag of 40 ms: latched messages and an old clock at its start, then five numbers."""
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        robot = writer.add_channel("/robot", TYPE, offers=[LATCHED])
        clock = writer.add_channel("/clock", "rosgraph_msgs/msg/Clock")
        number = writer.add_channel("/number", TYPE, offers=[DEEP])
        odd = MessageDefinition("ros2msg", "int64 data\n")
        gone = writer.add_channel("/gone", "no_such_msgs/msg/Odd", definition=odd)
        for channel, value in ((robot, 7), (robot, 8), (gone, 9)):
            writer.write(channel, serialize_message(Int64(data=value)), BEGIN, BEGIN)
        writer.write(clock, b"\0\1\0\0" + bytes(8), BEGIN, BEGIN)
        for i in range(5):
            data = serialize_message(Int64(data=i))
            writer.write(number, data, BEGIN + i * STEP, BEGIN + i * STEP)
    return folder


class Player:
    """A replay, the messages of its publishers, and the time."""

    def __init__(self, replay: Replay) -> None:
        self.replay = replay
        self.sent: list[tuple[str, int, float]] = []
        for topic, publisher in replay.publishers.items():
            publisher.publish = lambda data, topic=topic: self._note(topic, data)

    def _note(self, topic: str, data: bytes) -> None:
        self.sent.append((topic, int.from_bytes(data[4:12], "little"), time.monotonic()))

    def values(self, topic: str) -> list[int]:
        return [value for name, value, _ in self.sent if name == topic]


@pytest.fixture
def play(bag: Path, context: Context) -> Iterator[Callable[..., Player]]:
    with ExitStack() as stack:
        node = Node("replay", context=context, start_parameter_services=False)
        stack.callback(node.destroy_node)

        def _play(path: Path = bag, topics=(".*",), exclude=(), name: str = "") -> Player:
            reader = stack.enter_context(open_bag(path))
            return Player(Replay(node, reader, TopicSelection(topics, exclude), name))

        yield _play


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_messages_come_in_order_and_not_before_their_time(play, rate):
    player, seen = play(), list[float]()
    replay, began = player.replay, time.monotonic()
    replay.run(rate, lambda: seen.append(replay.position))
    assert player.values("/number") == [0, 1, 2, 3, 4] and player.values("/robot") == [7, 8]
    for topic, value, at in player.sent:
        due = began + 1e-9 * STEP * value / rate if topic == "/number" else began
        assert at >= due - 1e-4
    assert replay.messages == 8 and len(player.values("/clock")) == 1
    assert seen == sorted(seen) and seen[-1] == pytest.approx(replay.duration)
    assert replay.duration == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        ({}, {"/robot": 2, "/clock": 1000, "/number": 1000}),
        ({"name": "/left", "topics": ("/n.*",)}, {"/left/number": 1000}),
        ({"exclude": ("/(robot|clock)",)}, {"/number": 1000}),
    ],
)
def test_topics_are_chosen_and_renamed(play, options, topics):
    """A latched publisher keeps all messages of its topic."""
    replay = play(**options).replay
    publishers = replay.publishers.values()
    assert {p.topic_name: p.qos_profile.depth for p in publishers} == topics
    assert ("not installed" in replay.skipped.get("/gone", "")) == ("topics" not in options)


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        (("/none",), "can be published: --topics and --exclude leave none"),
        (("/gone",), "can be published: The message type"),
    ],
)
def test_what_cannot_be_replayed_is_refused(play, topics, words):
    with pytest.raises(BagError, match=re.escape(words)):
        play(topics=topics)


def test_a_bag_without_messages_cannot_be_replayed(play, tmp_path):
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_channel("/number", TYPE)
    with pytest.raises(BagError, match="it has no message"):
        play(tmp_path / "empty")


@pytest.mark.parametrize(
    ("offers", "reliability", "durability", "depth"),
    [
        ([], "RELIABLE", "VOLATILE", 1000),
        ([("BEST_EFFORT", "VOLATILE")] * 2, "BEST_EFFORT", "VOLATILE", 1000),
        ([("RELIABLE", "TRANSIENT_LOCAL")], "RELIABLE", "TRANSIENT_LOCAL", 3),
        ([("RELIABLE", "TRANSIENT_LOCAL"), ("RELIABLE", "VOLATILE")], "RELIABLE", "VOLATILE", 1000),
    ],
)
def test_publishers_offer_what_all_recorded_ones_offered(offers, reliability, durability, depth):
    offered = [
        SimpleNamespace(reliability=SimpleNamespace(name=one), durability=SimpleNamespace(name=two))
        for one, two in offers
    ]
    profile = replay_module.offered_qos(offered, 3)
    assert profile.reliability == ReliabilityPolicy[reliability]
    assert (profile.durability, profile.depth) == (DurabilityPolicy[durability], depth)


@pytest.mark.parametrize(
    ("argument", "text"),
    [
        ("--rate=0", "expected a number above 0"),
        ("--exclude=(", "not a valid regular expression"),
        ("--law=contact", "--law is set without --recompute"),
        ("--namespace=1x", "the namespace is '1x'"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(bag, domain, capsys, argument, text):
    assert main(["replay", str(bag), argument]) == 2
    *usage, said = capsys.readouterr().err.splitlines()
    assert text in said and len(usage) in (0, 3)
