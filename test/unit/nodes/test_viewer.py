# SPDX-License-Identifier: Apache-2.0
"""The viewer shows the newest data, each marker in its place, without guessing."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String
from support.messages import contacts_message, force_message, pose_message
from support.nodes import Process
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.nodes import viewer
from tactile_hand_ros.nodes.viewer import ViewerNode
from tactile_hand_ros.ros.endpoints import message_class

ROOT = Path(__file__).resolve().parents[3]
VIEWS = config_directory() / "views"
RVIZ_TOPICS = {"MarkerArray": "Topic", "RobotModel": "Description Topic"}


def place(marker: Marker) -> list[float]:
    at = marker.pose.position
    return [at.x, at.y, at.z]


STRAIGHT = [0.0, 0.0, 0.0, 1.0]
FINGERS = ("finger_1", "finger_2", "finger_3")
TOUCH = np.array([[0.1, 0.0, 0.4], [0.0, 0.2, 0.4], [np.nan] * 3])
TURNS = np.array([STRAIGHT, STRAIGHT, [np.nan] * 4])


class Stage:
    """A viewer, its input and its markers."""

    def __init__(self, here: Process) -> None:
        one_face = {"parameter_overrides": [Parameter("object.friction", value=0.5)]}
        self.viewer = ViewerNode(context=here.context, namespace="/left", **one_face)
        self.here, self._pictures = here, 0
        here.receive(MarkerArray, "/left/markers")
        here.wait(lambda: self.viewer.peers()["publications /left/markers"] == 1)

    def send(self, topic: str, message: Any) -> None:
        self.here.send(f"/left/{topic}", message)

    def force(self, finger: int, force: list[float]) -> None:
        message = force_message(force, 5, f"{FINGERS[finger]}_contact")
        self.send(f"tactile/{FINGERS[finger]}/wrench", message)

    def show(self) -> dict[str, list[Marker]]:
        self.viewer.show()
        self._pictures += 1
        found: dict[str, list[Marker]] = {}
        for marker in self.here.messages("/left/markers", self._pictures)[-1].markers:
            found.setdefault(marker.ns, []).append(marker)
        return found


@pytest.fixture
def stage(here: Process) -> Iterator[Stage]:
    made = Stage(here)
    yield made
    made.viewer.destroy_node()


def test_a_picture_holds_the_newest_of_everything(stage: Stage) -> None:
    """The arrow of the strongest force is 12 cm long, and none is drawn without a force."""
    assert set(stage.show()) == {""}
    for x in (1.0, 2.0):
        stage.send("ground_truth/object_pose", pose_message([x, 0.0, 0.0], STRAIGHT, 5))
        stage.send("accepted/desired_pose", pose_message([x, 1.0, 0.0], STRAIGHT, 5))
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    stage.force(0, [0.0, 0.0, 0.0])
    assert set(stage.show()) == {"", "object", "goal", "contacts"}
    stage.force(0, [0.0, 3.0, 0.0])
    stage.force(1, [2.0, 3.0, -6.0])
    shown = stage.show()
    assert [place(shown[name][0]) for name in ("object", "goal")] == [[2, 0, 0], [2, 1, 0]]
    for name in ("contacts", "forces"):
        assert [place(marker) for marker in shown[name]] == TOUCH[:2].tolist()
    ends = [[p.x, p.y, p.z] for arrow in shown["forces"] for p in arrow.points]
    scale, none = 0.12 / 7.0, [0.0] * 3
    expected = [none, [0.0, 3.0 * scale, 0.0], none, [2.0 * scale, 3.0 * scale, -6.0 * scale]]
    np.testing.assert_allclose(ends, expected)
    assert shown["forces"][0].type == Marker.ARROW
    frames = {m.header.frame_id for name, each in shown.items() if name for m in each}
    assert frames == {"left/palm"} and stage.show() == shown


def test_what_is_no_measurement_is_not_shown(stage: Stage) -> None:
    stage.send("tactile/contacts", contacts_message(TOUCH[:2], TURNS[:2], 5))  # of two fingers
    for turn in (STRAIGHT, [0.0] * 4):  # the second is no rotation
        stage.send("ground_truth/object_pose", pose_message([0.0] * 3, turn, 5))
        assert ("object" in stage.show()) == (turn is STRAIGHT)
    assert set(stage.show()) == {""}
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    for force in ([0.0, np.inf, 0.0], [np.nan, 1.0, 1.0]):
        stage.force(0, force)
        assert set(stage.show()) == {"", "contacts"}


def test_a_reset_drops_the_goal_until_the_next_is_accepted(stage: Stage) -> None:
    def accept(x: float) -> None:
        stage.send("accepted/desired_pose", pose_message([x, 1.0, 0.0], STRAIGHT, 5))

    accept(1.0)
    for stamp in (5_000_000_000, 5_002_000_000):
        stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, stamp))
        assert set(stage.show()) == {"", "goal", "contacts"}
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 4_998_000_000))  # late
    assert set(stage.show()) == {"", "goal", "contacts"}
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 0))
    assert set(stage.show()) == {"", "contacts"}
    accept(2.0)
    assert place(stage.show()["goal"][0]) == [2.0, 1.0, 0.0]


def test_a_best_effort_publisher_is_shown_and_wakes_nobody(stage: Stage) -> None:
    """An untaken QoS event would keep the executor awake, even after the publisher has left."""
    profile = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    stage.here.send("/left/tactile/contacts", contacts_message(TOUCH, TURNS, 5), profile)
    stage.here.wait(lambda: "contacts" in stage.show(), "the message")
    assert not any(each.event_handlers for each in stage.viewer.subscriptions)


def test_with_tf2_contacts_and_object_are_transforms(stage: Stage, monkeypatch: Any) -> None:
    """tf2_msgs is not among the wheels: a message with the same field replaces it."""
    sent: list[Any] = []
    assert stage.viewer._tf is None
    values = {pair.key: pair.value for pair in stage.viewer.diagnostics.status().values}
    assert values["tf"] == "tf2_msgs is not installed"
    monkeypatch.setattr(viewer, "TFMessage", SimpleNamespace)
    stage.viewer._tf = SimpleNamespace(publish=sent.append)
    stage.send("ground_truth/object_pose", pose_message([1.0, 0.0, 0.0], STRAIGHT, 5))
    stage.show()
    assert sent == []  # no contacts, no timestamp
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 1_500_000_000))
    stage.show()
    (message,) = sent
    expected = {"finger_1_contact": TOUCH[0], "finger_2_contact": TOUCH[1], "object": [1, 0, 0]}
    assert [t.child_frame_id for t in message.transforms] == [f"left/{n}" for n in expected]
    for transform, place_of in zip(message.transforms, expected.values(), strict=True):
        move, stamp = transform.transform.translation, transform.header.stamp
        np.testing.assert_allclose([move.x, move.y, move.z], place_of)
        assert transform.header.frame_id == "left/palm"
        assert (stamp.sec, stamp.nanosec) == (1, 500_000_000)


def topics_and_types() -> dict[str, Any]:
    """Return the message class of each topic in docs/reference/topics.md."""
    text = (ROOT / "docs" / "reference" / "topics.md").read_text("utf-8").split("## Services")[0]
    rows = re.findall(r"^\| `(\w[\w/]*)` \| (\w+)/(\w+) \|", text, re.M)
    return {f"/{topic}": message_class(f"{package}/msg/{kind}") for topic, package, kind in rows}


def test_the_rviz_view_names_topics_that_exist() -> None:
    rviz = yaml.safe_load((VIEWS / "tactile_hand.rviz").read_text("utf-8"))["Visualization Manager"]
    shown = {each["Class"].removeprefix("rviz_default_plugins/"): each for each in rviz["Displays"]}
    given = {kind: shown[kind][key]["Value"] for kind, key in RVIZ_TOPICS.items()}
    known = topics_and_types()
    assert known[given["MarkerArray"]] is MarkerArray and known[given["RobotModel"]] is String
    assert shown["RobotModel"]["Description Topic"]["Durability Policy"] == "Transient Local"
    assert rviz["Global Options"]["Fixed Frame"] == names.PALM_FRAME


def test_the_foxglove_layout_names_panels_topics_and_fields_that_exist() -> None:
    layout = json.loads((VIEWS / "foxglove.json").read_text("utf-8"))
    known, panels = topics_and_types(), layout["configById"]

    def leaves(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else leaves(part["first"]) + leaves(part["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    scene = panels["3D!hand"]
    assert scene["followTf"] == names.PALM_FRAME
    drawn = [*scene["topics"], *(layer["topic"] for layer in scene["layers"].values())]
    assert {known[topic] for topic in drawn} == {MarkerArray, String}
    plotted = [line["value"] for panel in panels.values() for line in panel.get("paths", [])]
    assert len(plotted) == 3
    for path in plotted:
        topic, *fields = path.split(".")
        value = known[topic]()
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, float), path
