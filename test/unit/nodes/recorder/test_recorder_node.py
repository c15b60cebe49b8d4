# SPDX-License-Identifier: Apache-2.0
"""The recorder node: what it records, what it reports, how it ends; alone and next to a hand."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import Int64

import tactile_hand_ros
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import node as recorder_module
from tactile_hand_ros.nodes.recorder import writer_process
from tactile_hand_ros.nodes.recorder.node import RecorderNode
from tactile_hand_ros.ros.diagnostics import ERROR, WARN
from tactile_hand_ros.ros.node import TickPublisher
from tactile_hand_ros.ros.processes import wait_until

EAGER = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
SCENARIO = "name: 'odd: \"1\"'\nseed: 7\ntargets:\n- {time: 0.0}\n"


class Stage:
    """A recorder next to a publishing node and a hand."""

    def __init__(self, context: Context, bag: Path) -> None:
        self.context, self.bag = context, bag
        self.talker = Node("talker", context=context)
        self.hand = Node("hand", context=context, namespace="left")
        self.recorder: RecorderNode
        self._executor = SingleThreadedExecutor(context=context)
        self._publishers: dict[str, Publisher] = {}

    def record(self, *local: TickPublisher, **options: Any) -> RecorderNode:
        values = {"output": str(self.bag), "topics": ["/left/.*"], **options}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.recorder = RecorderNode(local, context=self.context, parameter_overrides=overrides)
        self._executor.add_node(self.recorder)
        return self.recorder

    def publish(self, topic: str, *numbers: int) -> Publisher:
        if topic not in self._publishers:
            profile = QoSProfile(depth=1000)
            self._publishers[topic] = self.talker.create_publisher(Int64, topic, profile)
        for number in numbers:
            self._publishers[topic].publish(Int64(data=number))
        return self._publishers[topic]

    def spin_until(self, condition: Callable[[], bool]) -> None:
        def done() -> bool:
            self._executor.spin_once(timeout_sec=0.01)
            return condition()

        wait_until(done)

    def meet(self, *topics: str) -> None:
        """Spin until the recorder has subscribed to topics."""
        for topic in topics:
            self.spin_until(lambda t=topic: self.publish(t).get_subscription_count() == 1)

    def report(self) -> dict[str, str]:
        self.recorder.publish_diagnostics()
        return {pair.key: pair.value for pair in self.recorder.diagnostics.status().values}

    def recorded(self) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for message in read_messages(self.bag):
            number = int.from_bytes(message.data[4:12], "little")
            found.setdefault(message.topic, []).append(number)
        return found


@pytest.fixture
def stage(context: Context, tmp_path: Path) -> Iterator[Stage]:
    made = Stage(context, tmp_path / "bag")
    yield made
    if hasattr(made, "recorder"):
        with suppress(BagError):
            made.recorder.close()
        made.recorder.destroy_node()
    made.hand.destroy_node()
    made.talker.destroy_node()


def number(value: int) -> bytes:
    return bytes(serialize_message(Int64(data=value)))


def test_what_is_chosen_is_recorded_and_counted(stage):
    for topic in ("/left/a", "/left/b", "/right/a"):
        stage.publish(topic)
    stage.record(exclude=["/left/b"], scenario=SCENARIO, compression="lz4")
    stage.meet("/left/a")
    for topic in ("/left/a", "/left/b", "/right/a"):
        stage.publish(topic, 3, 4)
    stage.spin_until(lambda: stage.report()["messages"] == "2")
    report = stage.report()
    assert [report[key] for key in ("bytes", "topics", "lost_messages")] == ["24", "1", "0"]
    assert report["output"] == str(stage.bag) and report["refused_topics"] == "0"
    stage.publish("/left/a", 5)  # in transit at the end
    stage.recorder.close()
    assert stage.recorded() == {"/left/a": [3, 4, 5]}
    found = summarize(stage.bag).custom_data
    assert found["lost_messages"] == "0" and found["scenario"] == SCENARIO
    assert found["version_tactile_hand_ros"] == tactile_hand_ros.__version__


def test_what_publishers_offer_and_the_hash_of_their_type_are_in_the_bag(stage):
    """With a latched message from before the recorder, a best-effort topic, and two publishers."""
    offers = {
        "latched": [QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)],
        "mixed": [EAGER, QoSProfile(depth=10)],
        "sensor": [EAGER],
    }
    made = {
        topic: [stage.talker.create_publisher(Int64, f"/left/{topic}", each) for each in profiles]
        for topic, profiles in offers.items()
    }
    made["latched"][0].publish(Int64(data=1))
    stage.record()
    stage.spin_until(
        lambda: all(
            stage.recorder.peers().get(f"subscriptions /left/{topic}") == len(publishers)
            for topic, publishers in made.items()
        )
    )
    every = [publisher for each in made.values() for publisher in each]
    stage.spin_until(lambda: all(each.get_subscription_count() for each in every))
    for publisher in (*made["mixed"], *made["sensor"]):
        publisher.publish(Int64(data=2))
    stage.spin_until(lambda: stage.report()["messages"] == "4")
    stage.recorder.close()
    assert stage.recorded() == {"/left/latched": [1], "/left/mixed": [2, 2], "/left/sensor": [2]}
    with Reader(stage.bag) as reader:
        for found in reader.connections:
            (info, *_) = stage.talker.get_publishers_info_by_topic(found.topic)
            assert found.digest == str(info.topic_type_hash)
            given = [
                (p.reliability.name, p.durability.name) for p in found.ext.offered_qos_profiles
            ]
            profiles = offers[found.topic.removeprefix("/left/")]
            assert sorted(given) == [(p.reliability.name, p.durability.name) for p in profiles]


def test_what_is_missing_is_a_warning_and_in_the_bag(stage, monkeypatch):
    monkeypatch.setattr(recorder_module, "_QUEUE_DEPTH", 10)
    stage.record()
    stage.meet("/left/a")
    stage.publish("/left/a", 0)
    stage.spin_until(lambda: stage.report()["messages"] == "1")
    publisher = stage.publish("/left/a", *range(1, 100))
    assert publisher.wait_for_all_acked()
    stage.publish("/left/a", 100)
    stage.spin_until(lambda: int(stage.report()["lost_messages"]) > 0)
    report = stage.report()
    lost = int(report["lost_messages"])
    assert report["fault lost_messages"].startswith(f"{lost} messages were lost")
    assert stage.recorder.diagnostics.status().level == WARN
    stage.recorder.close()
    found = summarize(stage.bag)
    assert int(found.custom_data["lost_messages"]) == 101 - found.counts["/left/a"]
    assert found.custom_data["lost_messages/left/a"] == found.custom_data["lost_messages"]


def test_what_the_writer_refuses_is_lost_too(stage, monkeypatch):
    stage.record()
    stage.meet("/left/a")
    monkeypatch.setattr(writer_process, "_MAX_WAITING", -1)
    stage.publish("/left/a", 1, 2)
    stage.spin_until(lambda: stage.report()["lost_messages"] == "2")


def test_the_bag_is_closed_also_after_the_context_has_ended(stage):
    """With all received messages, even of a topic that had no publisher at the last look."""
    stage.hand.create_subscription(Int64, "late", print, 1)
    stage.record()
    stage.meet("/left/a")
    stage.spin_until(lambda: stage.talker.count_subscribers("/left/late") == 2)
    for topic in ("/left/late", "/left/a"):
        publisher = stage.publish(topic)
        wait_until(lambda p=publisher: p.get_subscription_count() > 0)
        stage.publish(topic, 1, 2)
        assert publisher.wait_for_all_acked()
    stage.context.try_shutdown()
    stage.recorder.close()
    assert stage.recorded() == {"/left/a": [1, 2], "/left/late": [1, 2]}
    assert (stage.bag / "metadata.yaml").exists()


def test_next_to_a_hand_the_bytes_of_its_publishers_are_taken_from_them(stage):
    """From the first message on, and without a subscription; other topics are subscribed."""
    inside = TickPublisher(stage.hand, Int64, "x", number)
    outside = TickPublisher(stage.hand, Int64, "/right/x", number)
    stage.record(inside, outside)
    for value in range(3):
        for publisher in (inside, outside):
            publisher.publish(value)
    stage.meet("/left/y")
    stage.publish("/left/y", 7)
    stage.spin_until(lambda: stage.report()["messages"] == "4")
    assert inside.get_subscription_count() == 0
    inside.publish(3)  # since the last visit
    stage.context.try_shutdown()
    stage.recorder.close()
    assert stage.recorded() == {"/left/x": [0, 1, 2, 3], "/left/y": [7]}
    assert summarize(stage.bag).types["/left/x"] == "std_msgs/msg/Int64"
    text = (stage.bag / "metadata.yaml").read_text()
    assert text.count("type_description_hash: RIHS01_") == 2 and text.count("reliability: ") == 2


def end_writer() -> None:
    children = psutil.Process(os.getpid()).children()
    (writer,) = (each for each in children if "writer_process" in " ".join(each.cmdline()))
    writer.send_signal(signal.SIGKILL)
    writer.wait()


def test_next_to_a_hand_a_bag_that_cannot_be_written_ends_the_recording_and_nothing_else(stage):
    inside = TickPublisher(stage.hand, Int64, "x", number)
    stage.record(inside)
    end_writer()
    inside.publish(1)
    stage.spin_until(lambda: stage.recorder.diagnostics.status().level == ERROR)
    inside.publish(2)
    assert "tactile-hand recover" in stage.report()["fault recording"]
    assert stage.context.ok()
    with pytest.raises(BagError, match="tactile-hand recover"):
        stage.recorder.close()


def test_a_recorder_alone_ends_with_the_error(stage):
    stage.record()
    end_writer()
    with pytest.raises(BagError, match="tactile-hand recover"):
        stage.spin_until(lambda: False)


def test_a_bag_that_exists_is_refused_before_anything_is_recorded(stage):
    stage.bag.mkdir()
    with pytest.raises(BagError, match="exists"):
        stage.record()
