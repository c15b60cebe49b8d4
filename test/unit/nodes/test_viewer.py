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
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from support.messages import contacts_message, force_message, pose_message
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.nodes import viewer
from tactile_hand_ros.nodes.viewer import Frame, ViewerNode, contact_markers
from tactile_hand_ros.ros.endpoints import message_class, subscribe_directly, take_latest
from tactile_hand_ros.ros.processes import wait_until

ROOT = Path(__file__).resolve().parents[3]
VIEWS = config_directory() / "views"
RVIZ_TOPICS = {"MarkerArray": "Topic", "RobotModel": "Description Topic"}
TURN = np.array([0.1, 0.2, 0.3, np.sqrt(0.86)])
FORCES = np.array([[1.0, 4.0, -2.0], [0.5, -1.0, 0.25], [0.0, 0.0, 0.0], [3.0, 8.0, 6.0]])


def drawn(forces: Any) -> dict[str, dict[int, Marker]]:
    """Return the markers of successive contacts, by namespace and finger."""
    places = [np.array([i, i + 0.25, i + 0.5]) for i in range(len(forces))]
    contacts = [Frame(f"c{i}", place, TURN) for i, place in enumerate(places)]
    found: dict[str, dict[int, Marker]] = {}
    with np.errstate(invalid="ignore"):
        for marker in contact_markers(contacts, np.array(forces)):
            found.setdefault(marker.ns, {})[marker.id] = marker
    return found


def points(marker: Marker) -> np.ndarray[Any, Any]:
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def place(marker: Marker) -> list[float]:
    at, turn = marker.pose.position, marker.pose.orientation
    return [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]


def at(number: int) -> list[float]:
    return [number, number + 0.25, number + 0.5, *TURN]


def test_a_force_is_an_arrow_and_the_strongest_is_twelve_centimetres_long() -> None:
    arrows = drawn([*FORCES, FORCES[0]])["forces"]
    assert sorted(arrows) == [0, 1, 3, 4]  # no arrow without a force
    for i, arrow in arrows.items():
        start, end = points(arrow)
        assert not start.any()
        np.testing.assert_allclose(end, [*FORCES, FORCES[0]][i] * 0.12 / np.sqrt(109.0))
        assert arrow.type == Marker.ARROW and place(arrow) == at(i)


@pytest.mark.parametrize("force", [[np.nan, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, np.inf, 0.0]])
def test_a_force_that_is_not_known_leaves_the_ball(force: list[float]) -> None:
    assert set(drawn([force])) == {"contacts"}


STRAIGHT = [0.0, 0.0, 0.0, 1.0]
FINGERS = ("finger_1", "finger_2", "finger_3")
TOUCH = np.array([[0.1, 0.0, 0.4], [0.0, 0.2, 0.4], [np.nan] * 3])
TURNS = np.array([STRAIGHT, STRAIGHT, [np.nan] * 4])
KINDS = {
    "tactile/contacts": PoseArray,
    "accepted/desired_pose": PoseStamped,
    "ground_truth/object_pose": PoseStamped,
    **{f"tactile/{finger}/wrench": WrenchStamped for finger in FINGERS},
}


class Stage:
    """A viewer, its input and its markers."""

    def __init__(self, context: Any) -> None:
        one_face = [Parameter("object.friction", value=0.5)]
        self.viewer = ViewerNode(context=context, namespace="/left", parameter_overrides=one_face)
        self.node = Node("hand", context=context, namespace="/left", start_parameter_services=False)
        self._publishers = {
            topic: self.node.create_publisher(kind, topic, QoSProfile(depth=10))
            for topic, kind in KINDS.items()
        }
        self._shown: Any = None
        wait_until(lambda: all(p.get_subscription_count() for p in self._publishers.values()))

    def send(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)
        assert self._publishers[topic].wait_for_all_acked()

    def watch(self) -> None:
        profile = QoSProfile(depth=1)
        self._shown = subscribe_directly(self.node, MarkerArray, "markers", profile)
        wait_until(lambda: self.viewer._markers.get_subscription_count() == 1)

    def show(self) -> dict[str, list[Marker]]:
        self.viewer.show()
        data = wait_until(lambda: take_latest(self._shown))
        found: dict[str, list[Marker]] = {}
        for marker in deserialize_message(data, MarkerArray).markers:
            found.setdefault(marker.ns, []).append(marker)
        return found


@pytest.fixture
def stage(context: Any) -> Iterator[Stage]:
    made = Stage(context)
    yield made
    made.viewer.destroy_node()
    made.node.destroy_node()


def test_a_picture_holds_the_newest_of_everything(stage: Stage) -> None:
    stage.watch()
    assert set(stage.show()) == {"all"}
    for x in (1.0, 2.0):
        stage.send("ground_truth/object_pose", pose_message([x, 0.0, 0.0], STRAIGHT, 5))
        stage.send("accepted/desired_pose", pose_message([x, 1.0, 0.0], STRAIGHT, 5))
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    assert set(stage.show()) == {"all", "object", "goal", "contacts"}
    stage.send("tactile/finger_1/wrench", force_message([0.0, 3.0, 0.0], 5, "finger_1_contact"))
    stage.send("tactile/finger_2/wrench", force_message([0.0, 6.0, 0.0], 5, "finger_2_contact"))
    shown = stage.show()
    assert place(shown["object"][0])[:3] == [2.0, 0.0, 0.0] and place(shown["goal"][0])[:3] == [
        2.0,
        1.0,
        0.0,
    ]
    assert [place(ball)[:3] for ball in shown["contacts"]] == TOUCH[:2].tolist()
    assert [arrow.points[1].y for arrow in shown["forces"]] == pytest.approx([0.06, 0.12])
    assert {m.header.frame_id for each in shown.values() for m in each} == {"left/palm"}
    assert stage.show() == shown


def test_what_is_no_measurement_is_not_shown(stage: Stage) -> None:
    stage.watch()
    stage.send("tactile/contacts", contacts_message(TOUCH[:2], TURNS[:2], 5))  # of two fingers
    for turn in (STRAIGHT, [0.0] * 4):  # the second is no rotation
        stage.send("ground_truth/object_pose", pose_message([0.0] * 3, turn, 5))
        assert ("object" in stage.show()) == (turn is STRAIGHT)
    assert set(stage.show()) == {"all"}
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    wrong = force_message([0.0, np.inf, 0.0], 5, "finger_1_contact")
    stage.send("tactile/finger_1/wrench", wrong)
    assert set(stage.show()) == {"all", "contacts"}


def test_a_best_effort_publisher_is_shown_and_wakes_nobody(stage: Stage) -> None:
    """An untaken QoS event would keep the executor awake, even after the publisher has left."""
    stage.watch()
    profile = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    driver = stage.node.create_publisher(PoseArray, "tactile/contacts", profile)
    wait_until(lambda: driver.get_subscription_count() == 1)

    def is_shown() -> bool:
        driver.publish(contacts_message(TOUCH, TURNS, 5))
        return "contacts" in stage.show()

    wait_until(is_shown)
    taken = list(stage.viewer.subscriptions)
    assert len(taken) == len(KINDS) and not any(each.event_handlers for each in taken)


def test_the_reliability_of_what_is_shown_can_be_overridden(context: Any) -> None:
    name = "qos_overrides./tactile/contacts.subscription.reliability"
    made = ViewerNode(context=context, parameter_overrides=[Parameter(name, value="reliable")])
    profiles = {each.topic_name: each.qos_profile for each in made.subscriptions}
    assert profiles["/tactile/contacts"].reliability.name == "RELIABLE"
    made.destroy_node()


def test_with_tf2_contacts_and_object_are_transforms(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """tf2_msgs is not among the wheels: a message with the same field replaces it."""
    sent: list[Any] = []
    assert stage.viewer._tf is None
    values = {pair.key: pair.value for pair in stage.viewer.diagnostics.status().values}
    assert values["tf"] == "tf2_msgs is not installed"
    monkeypatch.setattr(viewer, "TFMessage", SimpleNamespace)
    stage.viewer._tf = SimpleNamespace(publish=sent.append)
    stage.send("ground_truth/object_pose", pose_message([1.0, 0.0, 0.0], STRAIGHT, 5))
    stage.viewer.show()
    assert sent == []  # no contacts, no timestamp
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 1_500_000_000))
    stage.viewer.show()
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
