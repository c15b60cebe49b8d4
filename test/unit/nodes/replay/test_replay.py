# SPDX-License-Identifier: Apache-2.0
"""A replay in this process: what is published, when, from where on, and how often."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, Int64
from std_srvs.srv import SetBool

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.replay import replay as replay_module
from tactile_hand_ros.nodes.replay.node import replaying
from tactile_hand_ros.nodes.replay.options import ReplayOptions, ReplayProgress
from tactile_hand_ros.nodes.replay.replay import Replay
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until

TYPE, BEGIN, STEP = "std_msgs/msg/Int64", 10**18, 10_000_000
LATCHED = offered_qos(QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
DEEP = offered_qos(QoSProfile(depth=1))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag of 40 ms: a latched message and an old clock at its begin, then five numbers."""
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        robot = writer.add_channel("/robot", TYPE, offers=[LATCHED])
        clock = writer.add_channel("/clock", "rosgraph_msgs/msg/Clock")
        number = writer.add_channel("/number", TYPE, offers=[DEEP])
        gone = writer.add_channel("/gone", TYPE)
        for channel, value in ((robot, 7), (robot, 8), (gone, 9)):
            writer.write(channel, serialize_message(Int64(data=value)), BEGIN, BEGIN)
        writer.write(clock, b"\0\1\0\0" + bytes(8), BEGIN, BEGIN)
        for i in range(5):
            data = serialize_message(Int64(data=i))
            writer.write(number, data, BEGIN + i * STEP, BEGIN + i * STEP)
    return folder


class Player:
    """A replay and what its publishers are given, with the time."""

    def __init__(self, node: Node, bag: Path, **options: Any) -> None:
        values = {"exclude": ("/gone",), **options}
        self.replay = Replay(node, bag, ReplayOptions(**values))
        self.sent: list[tuple[str, int, float]] = []
        for topic, publisher in self.replay._publishers.items():
            publisher.publish = lambda data, topic=topic: self._note(topic, data)
        self.clock: list[int] = []
        if self.replay._clock is not None:
            self.replay._clock.publish = lambda data: self.clock.append(header_stamp(data))

    def _note(self, topic: str, data: bytes) -> None:
        self.sent.append((topic, int.from_bytes(data[4:12], "little"), time.monotonic()))

    def values(self, topic: str) -> list[int]:
        return [value for name, value, _ in self.sent if name == topic]


@pytest.fixture
def play(bag: Path) -> Iterator[Callable[..., Player]]:
    made: list[Player] = []
    with isolated_domain() as domain, private_context(domain) as context:
        node = Node("replay", context=context, start_parameter_services=False)

        def _play(**options: Any) -> Player:
            made.append(Player(node, bag, **options))
            return made[-1]

        yield _play
        for player in made:
            player.replay.close()
        node.destroy_node()


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_numbers_come_in_order_and_not_before_their_time(
    play: Callable[..., Player], rate: float
) -> None:
    player, seen = play(rate=rate), list[ReplayProgress]()
    began = time.monotonic()
    progress = player.replay.run(seen.append)
    assert player.values("/number") == [0, 1, 2, 3, 4] and player.values("/robot") == [7, 8]
    assert player.values("/gone") == [] and len(player.values("/clock")) == 1
    for topic, value, at in player.sent:
        due = began + 1e-9 * STEP * value / rate if topic == "/number" else began
        assert at >= due - 1e-4
    assert progress is player.replay.progress and progress.messages == 8
    assert progress.duration == pytest.approx(0.04) and progress.position == pytest.approx(0.04)
    assert 0.0 < progress.late < 5.0 and not progress.paused
    assert len(seen) >= 2


@pytest.mark.parametrize(("offset", "numbers"), [(0.02, [2, 3, 4]), (0.021, [3, 4]), (0.04, [4])])
def test_from_later_on_a_latched_message_is_that_of_before(
    play: Callable[..., Player], offset: float, numbers: list[int]
) -> None:
    player = play(start_offset=offset, rate=100.0)
    player.replay.run()
    assert player.values("/robot") == [8] and player.values("/number") == numbers
    assert player.values("/clock") == []


@pytest.mark.parametrize("offset", [-1e-9, 0.0400001])
def test_an_offset_outside_of_the_bag_is_refused(
    play: Callable[..., Player], offset: float
) -> None:
    with pytest.raises(BagError, match=r"expected 0 to 0\.04 s"):
        play(start_offset=offset)


def test_a_clock_of_its_own_replaces_that_of_the_bag(play: Callable[..., Player]) -> None:
    player = play(clock=100.0, rate=0.5)
    assert "/clock" not in player.replay.topics
    player.replay.run()
    stamps = player.clock
    assert len(stamps) >= 2 and stamps == sorted(stamps) and stamps[0] >= BEGIN
    gaps = [later - stamp for stamp, later in zip(stamps, stamps[1:], strict=False)]
    assert min(gaps) >= 4_990_000  # of the bag's time, of which 10 ms are 5


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        ({}, ["/robot", "/clock", "/number"]),
        ({"namespace": "/left"}, ["/left/robot", "/left/clock", "/left/number"]),
        ({"topics": ("/n.*",)}, ["/number"]),
        ({"exclude": ("/(robot|clock)",)}, ["/number", "/gone"]),
    ],
)
def test_topics_are_chosen_and_renamed(
    play: Callable[..., Player], options: dict[str, Any], topics: list[str]
) -> None:
    assert sorted(play(**options).replay.topics) == sorted(topics)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"topics": ("/none",)}, "can be published: --topics and --exclude leave none"),
        ({"namespace": "1st"}, "'1st' is not a namespace"),
    ],
)
def test_what_cannot_be_replayed_is_refused(
    play: Callable[..., Player], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(BagError, match=re.escape(words)):
        play(**options)


def test_a_loop_begins_again_after_a_tenth_of_a_second_until_it_is_stopped(
    play: Callable[..., Player],
) -> None:
    player = play(loop=True, topics=("/number",), rate=100.0)
    began = time.monotonic()
    player.replay.run(stop=lambda: len(player.sent) >= 10)
    assert player.values("/number") == [0, 1, 2, 3, 4] * 2
    assert player.sent[5][2] - began >= 0.099


def test_a_replay_that_is_stopped_publishes_nothing_more(play: Callable[..., Player]) -> None:
    player = play()
    assert player.replay.run(stop=lambda: True).messages == 0 and player.sent == []


def test_a_delay_is_waited_for_and_a_pause_stands_still(play: Callable[..., Player]) -> None:
    player = play(delay=0.05, paused=True, rate=100.0)
    service = player.replay._on_pause
    began, answers = time.monotonic(), list[tuple[bool, str]]()

    def watch(progress: ReplayProgress) -> None:
        if time.monotonic() - began > 0.12 and not answers:
            assert progress.paused and player.sent == []
            answer = service(SetBool.Request(data=False), SetBool.Response())
            answers.append((answer.success, answer.message))

    player.replay.run(watch)
    assert answers == [(True, "running")] and len(player.sent) == 8
    assert player.sent[0][2] - began >= 0.12
    player.replay.toggle()
    assert player.replay.progress.paused
    answer = service(SetBool.Request(data=True), SetBool.Response())
    assert answer.message == "paused" and player.replay.progress.paused
    player.replay.toggle()
    assert not player.replay.progress.paused


def test_a_delay_comes_before_the_first_message(play: Callable[..., Player]) -> None:
    player, began = play(delay=0.05, rate=100.0), time.monotonic()
    player.replay.run()
    assert player.sent[0][2] - began >= 0.0499


def test_each_publisher_waits_up_to_a_second_for_its_subscribers(
    play: Callable[..., Player],
) -> None:
    player, waited = play(rate=100.0), list[tuple[str, float]]()
    for topic, publisher in player.replay._publishers.items():
        publisher.wait_for_all_acked = lambda timeout, topic=topic: waited.append(
            (topic, 1e-9 * timeout.nanoseconds)
        )
    player.replay.run()
    assert sorted(waited) == [("/clock", 1.0), ("/number", 1.0), ("/robot", 1.0)]


def test_a_round_of_a_loop_takes_a_tenth_of_a_second(play: Callable[..., Player]) -> None:
    player, delays = play(loop=True, delay=0.5, rate=100.0), list[float]()
    player.replay._pause_for = lambda delay, *_: delays.append(delay)  # type: ignore[method-assign]
    player.replay.run(stop=lambda: len(delays) > 2)
    assert delays[0] == 0.5 and all(0.0 < delay < 0.1 for delay in delays[1:])


def test_between_messages_it_sleeps_as_long_as_it_may(play: Callable[..., Player]) -> None:
    player, slept = play(topics=("/number",)), list[float]()
    wait = player.replay._changed.wait
    player.replay._changed.wait = lambda timeout: slept.append(timeout) or wait(timeout)  # type: ignore[method-assign, func-returns-value]
    player.replay.run()
    assert 4 <= len(slept) < 40 and all(0.0 <= each <= 0.0101 for each in slept)
    assert max(slept) > 0.001


@pytest.mark.parametrize(("early", "position"), [(10**9, 0.0), (-(10**9), 0.04), (-STEP, 0.01)])
def test_the_position_is_that_in_the_bag(
    play: Callable[..., Player], early: int, position: float
) -> None:
    player, seen = play(), list[float]()
    player.replay._timeline.jump(BEGIN - early, 0.0)
    player.replay._note(0.0, lambda progress: seen.append(progress.position))
    assert seen == [pytest.approx(position)]


def test_a_latched_publisher_keeps_all_messages_of_its_topic(play: Callable[..., Player]) -> None:
    profiles = {t: p.qos_profile for t, p in play().replay._publishers.items()}
    assert {topic: profile.depth for topic, profile in profiles.items()} == {
        "/robot": 2,
        "/clock": 1000,
        "/number": 1000,
    }


def test_what_cannot_be_published_is_named(
    play: Callable[..., Player], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, node = tmp_path / "other", play().replay._node
    with BagWriter(folder) as writer:
        writer.add_channel("/number", TYPE)
        other = writer.add_channel("/other", "std_msgs/msg/Float64")
        writer.write(other, serialize_message(Float64()), BEGIN, BEGIN)
    known, missing = replay_module.message_class, [TYPE]

    def class_of(kind: str) -> Any:
        if kind in missing:
            raise BagError(f"{kind} is not installed")
        return known(kind)

    monkeypatch.setattr(replay_module, "message_class", class_of)
    replay = Replay(node, folder, ReplayOptions())
    assert replay.skipped == {"/number": f"{TYPE} is not installed"}
    assert replay.topics == ["/other"]
    replay.close()
    missing.append("std_msgs/msg/Float64")
    words = f"published: {TYPE} is not installed; std_msgs/msg/Float64 is not installed"
    with pytest.raises(BagError, match=words):
        Replay(node, folder, ReplayOptions())


def test_a_bag_without_messages_cannot_be_replayed(
    play: Callable[..., Player], tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_channel("/number", TYPE)
    with pytest.raises(BagError, match="has no message; there is nothing to replay"):
        Replay(play().replay._node, tmp_path / "empty", ReplayOptions())


def test_a_replay_has_a_node_a_context_and_a_thread_of_its_own_while_it_lasts(bag: Path) -> None:
    before = threading.active_count()
    with isolated_domain() as domain, private_context(domain) as context:
        user = Node("user", context=context, start_parameter_services=False)
        client = user.create_client(SetBool, "/replay/pause")
        with replaying(bag, ReplayOptions(paused=True)) as player:
            node = player._node
            assert node.context.ok() and node.get_name() == "replay"
            wait_until(client.service_is_ready)
            client.call_async(SetBool.Request(data=False))
            wait_until(lambda: not player.progress.paused)
            assert threading.active_count() > before
        assert not node.context.ok()
        with pytest.raises(Exception, match=r"."):
            next(iter(player._messages()))  # the bag is closed
        user.destroy_node()
    wait_until(lambda: threading.active_count() <= before)


def test_a_bag_that_cannot_be_replayed_leaves_nothing_behind(tmp_path: Path) -> None:
    before = threading.active_count()
    with (
        isolated_domain(),
        pytest.raises(BagError),
        replaying(tmp_path / "none", ReplayOptions()),
    ):
        pass
    wait_until(lambda: threading.active_count() <= before)
