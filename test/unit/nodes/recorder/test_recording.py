# SPDX-License-Identifier: Apache-2.0
"""A recording of a graph in this process: what is taken, when it is written, what is counted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64

from tactile_hand_ros.bag.reader import read_raw, summarize
from tactile_hand_ros.nodes.recorder import recording as recording_module
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.recording import Recording
from tactile_hand_ros.nodes.recorder.shared_recording import SharedRecording
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until


class Stage:
    """A node that publishes numbers, and recordings of it."""

    def __init__(self, context: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.node = Node("hand", context=context, start_parameter_services=False)
        self.bag = folder / "bag"
        self._sent: dict[str, Any] = {}
        monkeypatch.setattr(recording_module, "QUIET", 0.005)
        monkeypatch.setattr(recording_module, "LAST_CALL", 0.05)

    def record(self, **options: Any) -> Recording:
        values = {"output": str(self.bag), "topics": ["/left/.*"], "discovery_period": 0.001}
        return Recording(self.node, RecorderConfig(**{**values, **options}))

    def publish(self, topic: str, *numbers: int) -> None:
        if topic not in self._sent:
            self._sent[topic] = self.node.create_publisher(Int64, topic, QoSProfile(depth=50))
        for number in numbers:
            self._sent[topic].publish(Int64(data=number))

    def met(self, *topics: str) -> bool:
        return all(self._sent[topic].get_subscription_count() == 1 for topic in topics)

    def recorded(self) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for message in read_raw(self.bag):
            number = int.from_bytes(message.data[4:12], "little")
            found.setdefault(message.topic, []).append(number)
        return found


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    with isolated_domain() as domain, private_context(domain) as context:
        made = Stage(context, tmp_path, monkeypatch)
        yield made
        made.node.destroy_node()


def test_what_is_chosen_is_written_and_counted(stage: Stage) -> None:
    for topic in ("/left/a", "/left/b", "/right/a"):
        stage.publish(topic)
    recording = stage.record(exclude=["/left/b"])
    wait_until(lambda: recording.step() == 0 and stage.met("/left/a"))
    assert recording.status.topics == 1
    for topic in ("/left/a", "/left/b", "/right/a"):
        stage.publish(topic, 3, 4)
    written = [0]

    def take() -> bool:
        written[0] += recording.step()
        return written[0] >= 2

    wait_until(take)
    status = recording.status
    assert (written[0], status.messages, status.size, status.topics) == (2, 2, 24, 1)
    assert (status.lost, status.refused, recording.lost()) == (0, 0, {})
    assert recording.folder == stage.bag
    stage.publish("/left/a", 5)  # on its way when it ends
    recording.close()
    assert stage.recorded() == {"/left/a": [3, 4, 5]}
    told = summarize(stage.bag).custom_data
    assert told["lost_messages"] == "0" and "lost_messages/left/a" not in told


def test_a_publisher_that_comes_later_is_recorded_and_gaps_are_told(stage: Stage) -> None:
    subscriber = stage.node.create_subscription(Int64, "/left/a", print, 1)
    recording = stage.record()
    wait_until(lambda: recording.step() == 0 and recording.status.topics == 1)
    stage.node.destroy_subscription(subscriber)
    topic = recording._topics["/left/a"]
    assert topic.channel is None and topic.publishers == 0
    stage.publish("/left/a")
    wait_until(lambda: recording.step() == 0 and topic.publishers == 1 and stage.met("/left/a"))
    assert topic.channel is not None
    assert Recording.calm_after == 5.0 and SharedRecording.calm_after == 0.5
    stage.publish("/left/a", 1)
    wait_until(lambda: recording.step() == 1)
    topic._sequence.lost = 7
    assert recording.lost() == {"/left/a": 7} and recording.status.lost == 7
    recording.close()
    told = summarize(stage.bag).custom_data
    assert (told["lost_messages"], told["lost_messages/left/a"]) == ("7", "7")
    assert stage.recorded() == {"/left/a": [1]}


def test_a_snapshot_writes_what_is_in_memory_and_nothing_else_is_written(stage: Stage) -> None:
    stage.publish("/left/a")
    recording = stage.record(snapshot_duration=60.0)
    wait_until(lambda: recording.step() == 0 and stage.met("/left/a"))
    assert recording.snapshot() == 0 and not list(stage.bag.glob("*.mcap"))
    stage.publish("/left/a", 1, 2, 3)
    wait_until(lambda: recording.step() > 0)
    assert recording.status.messages == 0
    wait_until(lambda: recording.step() == 0 and len(recording._buffer or ()) == 3)
    assert recording.snapshot() == 3 and recording.status.messages == 3
    assert stage.recorded() == {"/left/a": [1, 2, 3]}
    assert recording.snapshot() == 0
    recording.close()


def test_a_graph_that_does_not_change_is_looked_at_ten_times_less_often(stage: Stage) -> None:
    recording = stage.record(discovery_period=0.5)
    attention = recording._attention
    assert attention._calm_after == 5.0
    assert attention.period(True) == 0.5 and not recording.is_calm
    attention._calm_after = 0.0
    assert attention.period(False) == 5.0 and recording.is_calm
    recording.close()


def test_chunks_reach_the_disk_once_in_a_flush_period(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = stage.record(flush_period=10.0, discovery_period=1.0)
    now, flushed = [1000.0], list[float]()
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(recording_module, "time", clock)
    monkeypatch.setattr(recording._writer, "flush", lambda: flushed.append(now[0]))
    looked: list[float] = []
    monkeypatch.setattr(recording, "_discover", lambda: looked.append(now[0]) or False)
    for passed in (0.0, 0.5, 0.5, 0.25, 8.75, 1.0):
        now[0] += passed
        recording.step()
    assert flushed == [1000.0, 1010.0]
    assert looked == [1000.0, 1001.0, 1010.0, 1011.0]
    monkeypatch.undo()
    recording.close()


def test_a_topic_with_publishers_is_in_the_bag_before_its_first_message(stage: Stage) -> None:
    stage.publish("/left/a")
    recording, opened = stage.record(), list[Any]()
    add_channel = recording._writer.add_channel

    def noted(*args: Any, **options: Any) -> int:
        opened.append((args, options))
        return add_channel(*args, **options)

    recording._writer.add_channel = noted  # type: ignore[method-assign]
    wait_until(lambda: recording.step() == 0 and recording._topics)
    (topic,) = recording._topics.values()
    assert topic.channel == 1 and topic.publishers == 1
    (((name, kind), options),) = opened
    assert (name, kind) == ("/left/a", "std_msgs/msg/Int64")
    assert options["type_hash"].startswith("RIHS01_") and len(options["offers"]) == 1
    recording.close()


def test_a_type_that_is_not_installed_is_refused_once_with_its_topic(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, lines = stage.record(), list[str]()
    logger = stage.node.get_logger()
    monkeypatch.setattr(logger, "error", lines.append)
    monkeypatch.setattr(stage.node, "get_logger", lambda: logger)
    for _ in range(2):
        assert not recording._consider("/left/odd", "no_such_msgs/msg/Odd")
    assert not recording._consider("/right/a", "std_msgs/msg/Int64")  # not chosen
    assert recording.status.refused == 1 and recording.status.topics == 0
    assert len(lines) == 1 and lines[0].startswith("/left/odd is not recorded: ")
    assert recording._consider("/left/a", "std_msgs/msg/Int64")
    assert recording._topics["/left/a"].channel is None  # no publisher yet
    recording.close()


def test_a_bag_is_made_as_it_is_configured(stage: Stage) -> None:
    recording = stage.record(
        compression="lz4",
        chunk_size=2048,
        split_size=4096,
        split_duration=1.5,
        snapshot_duration=0.5,
        scenario="name: x",
    )
    assert recording._buffer is not None and recording._buffer._duration == 500_000_000
    stage.bag.parent.joinpath("other").mkdir()
    config = RecorderConfig(output=str(stage.bag.parent / "new"), scenario="name: x")
    asked = recording._bag(recording._config.changed({"output": config.output}))
    custom = asked.pop("custom_data")
    assert asked == {
        "folder": Path(config.output),
        "compression": "lz4",
        "chunk_size": 2048,
        "max_size": 4096,
        "max_duration": 1_500_000_000,
        "earlier": None,
        "lazy": True,
    }
    assert custom["scenario"] == "name: x"
    plain = stage.node  # without a snapshot everything is written at once
    assert not Recording(plain, config)._bag(config.changed({"output": "elsewhere"}))["lazy"]
    recording.close()
