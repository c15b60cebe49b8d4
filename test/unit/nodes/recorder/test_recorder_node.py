# SPDX-License-Identifier: Apache-2.0
"""The node of the recorder: its rhythm, its diagnostics, its end; alone and beside a hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import recording as recording_module
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.nodes.recorder.node import RecorderNode
from tactile_hand_ros.nodes.recorder.shared_recording import SharedRecording
from tactile_hand_ros.ros.diagnostics import ERROR, WARN
from tactile_hand_ros.ros.direct.delivery import deliver_directly, direct_delivery
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.node import TactileNode

FULL = BagError("the disk is full, make room.")


def said(node: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in node.diagnostics.status().values}


@pytest.fixture(autouse=True)
def _soon_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_module, "QUIET", 0.005)
    monkeypatch.setattr(recording_module, "LAST_CALL", 0.05)


@pytest.fixture(params=["alone"])
def context(request: pytest.FixtureRequest) -> Iterator[Any]:
    with isolated_domain() as domain, private_context(domain) as made:
        if request.param == "shared":
            deliver_directly(made)
        yield made


@pytest.fixture
def make(context: Any, tmp_path: Path) -> Iterator[Callable[..., RecorderNode]]:
    made: list[Any] = []

    def _make(*is_over: Callable[[], bool], **options: Any) -> RecorderNode:
        values = {"output": str(tmp_path / "bag"), "topics": ["/left/.*"], **options}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        made.append(RecorderNode(*is_over, context=context, parameter_overrides=overrides))
        return made[-1]

    yield _make
    for node in made:
        if node._recording._writer.is_open:
            node._recording.close()
        node.destroy_node()


shared = pytest.mark.parametrize("context", ["shared"], indirect=True)


@pytest.mark.parametrize("key", ["topics", "exclude"])
def test_a_pattern_that_is_none_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match="not a valid regular expression"):
        RecorderConfig(output="x", **{key: ["(", ".*"]})
    assert getattr(RecorderConfig(output="x", **{key: ["a.*"]}), key) == ["a.*"]


@pytest.mark.parametrize(
    ("came", "is_calm", "period"),
    [(0, True, 0.1), (9, True, 0.1), (10, True, 0.02), (0, False, 0.02), (11, False, 0.02)],
)
def test_queues_are_visited_less_often_while_next_to_nothing_comes(
    make: Callable[..., RecorderNode],
    monkeypatch: pytest.MonkeyPatch,
    came: int,
    is_calm: bool,
    period: float,
) -> None:
    node = make(drain_period=0.02)
    assert node._visits.timer_period_ns == 20_000_000
    node._visits.timer_period_ns = 77_000_000
    monkeypatch.setattr(node._recording, "step", lambda: came)
    monkeypatch.setattr(type(node._recording), "is_calm", property(lambda _: is_calm))
    node._on_visit()
    assert node._visits.timer_period_ns == round(1e9 * period)
    assert node.diagnostics.ticks == (came > 0)


def test_counters_are_reported_and_what_is_missing_is_a_warning(
    make: Callable[..., RecorderNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make()
    counts = dict(messages=5, size=60, topics=3, lost=0, refused=0)
    status = SimpleNamespace(**counts)
    monkeypatch.setattr(type(node._recording), "status", property(lambda _: status))
    node.publish_diagnostics()
    facts = said(node)
    keys = ("messages", "bytes", "topics", "lost_messages", "refused_topics")
    assert [facts[key] for key in keys] == ["5", "60", "3", "0", "0"]
    assert facts["output"] == str(node._recording.folder)
    assert not any(key.startswith("fault") for key in facts)
    status.lost, status.refused = 1, 2
    node.publish_diagnostics()
    facts = said(node)
    assert facts["fault lost_messages"] == "1 messages were lost before they were recorded"
    assert facts["fault refused_topics"] == "2 topics have a type that is not installed"
    assert node.diagnostics.status().level == WARN


def test_when_it_is_over_the_bag_is_finished_and_the_context_ends(
    make: Callable[..., RecorderNode], tmp_path: Path
) -> None:
    over = [False]
    node = make(lambda: over[0])
    node._on_visit()
    assert node.context.ok() and not (tmp_path / "bag" / "metadata.yaml").exists()
    over[0] = True
    node._on_visit()
    assert not node.context.ok() and (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_recorder_alone_ends_with_the_error_of_its_disk(
    make: Callable[..., RecorderNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make()

    def fail() -> int:
        raise FULL

    monkeypatch.setattr(node._recording, "step", fail)
    with pytest.raises(BagError, match="make room"):
        node._on_visit()
    with pytest.raises(BagError, match="make room"):
        monkeypatch.setattr(node._recording, "rest", fail)
        node._on_rest()


def test_a_snapshot_is_answered_with_its_size_or_the_reason(
    make: Callable[..., RecorderNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make(snapshot_duration=1.0)
    services = {service.srv_name for service in node.services}
    assert "/recorder/snapshot" in services or "~/snapshot" in services

    def ask() -> tuple[bool, str]:
        answer = node._on_snapshot(Trigger.Request(), Trigger.Response())
        return answer.success, answer.message

    monkeypatch.setattr(node._recording, "snapshot", lambda: 2)
    assert ask() == (True, f"2 messages went to {node._recording.folder}")

    def fail() -> int:
        raise FULL

    monkeypatch.setattr(node._recording, "snapshot", fail)
    assert ask() == (False, str(FULL))


def test_without_a_snapshot_there_is_no_service_for_it(
    make: Callable[..., RecorderNode],
) -> None:
    assert not any("snapshot" in service.srv_name for service in make().services)


@shared
def test_beside_a_hand_it_notes_what_publishers_of_its_process_send(
    make: Callable[..., RecorderNode], context: Any, tmp_path: Path
) -> None:
    """From the first message on; they are written when all have answered each other."""
    node = make()
    node.check_ready()
    recording = node._recording
    assert isinstance(recording, SharedRecording)
    hand = TactileNode("hand", Config, context=context, namespace="left")
    publisher = hand.create_publisher(Int64, "x", QoSProfile(depth=5))
    other = hand.create_publisher(Int64, "/right/x", QoSProfile(depth=5))
    data = [bytes(serialize_message(Int64(data=value))) for value in range(4)]
    for each in data[:2]:
        publisher.publish(each)
        other.publish(each)
    topic = recording._topics["/left/x"]
    assert [d for t, d, _ in recording._tapped if t is topic] == data[:2]
    assert recording.status.messages == 0 and not topic.is_remote
    between = node._between.spent.copy()
    delivery = direct_delivery(context)
    assert delivery is not None
    delivery.rest()
    assert recording.status.messages == 2 and recording._tapped == []
    assert node._between.spent["recorder"] > between["recorder"]
    publisher.publish(data[2])
    assert recording._drain() == 0 and recording.status.messages == 3
    publisher.publish(data[3])
    recording._writer.lost[topic.channel or 0] += 2
    assert recording.lost() == {"/left/x": 2}
    node.close()
    found = [message for message in read_raw(tmp_path / "bag") if message.topic == "/left/x"]
    assert [message.data for message in found] == data
    hand.destroy_node()


@shared
def test_beside_a_hand_a_full_disk_ends_the_recording_and_nothing_else(
    make: Callable[..., RecorderNode], monkeypatch: pytest.MonkeyPatch, context: Any
) -> None:
    node, lines, told = make(), list[str](), list[int]()
    node.check_ready()
    logger = node.get_logger()
    monkeypatch.setattr(logger, "error", lines.append)
    monkeypatch.setattr(node, "get_logger", lambda: logger)
    monkeypatch.setattr(node, "publish_diagnostics", lambda: told.append(1))

    def fail() -> int:
        raise FULL

    monkeypatch.setattr(node._recording, "rest", fail)
    node._recording._consider("/left/x", "std_msgs/msg/Int64")
    assert node._recording._topics
    node._on_rest()
    node._on_rest()
    assert lines == [str(FULL)] and told == [1]
    assert node._visits.is_canceled() and not node._recording._topics
    status = node.diagnostics.status()
    assert (status.level, status.message) == (ERROR, str(FULL)) and node.context.ok()
    with pytest.raises(BagError, match="make room"):
        node.close()


@shared
def test_beside_a_hand_a_bag_that_exists_is_refused_before_the_first_tick(
    make: Callable[..., RecorderNode], tmp_path: Path
) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "file").write_text("x")
    node = make()
    with pytest.raises(BagError, match="exists"):
        node.check_ready()
    node._recording._writer.is_open = False
