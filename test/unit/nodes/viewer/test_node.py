# SPDX-License-Identifier: Apache-2.0
"""The viewer shows the newest of what it was sent, over real DDS in this process."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from support.messages import contacts_message, force_message, joint_message, pose_message
from visualization_msgs.msg import Marker, MarkerArray

from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.viewer import node as viewer
from tactile_hand_ros.nodes.viewer.node import ViewerNode
from tactile_hand_ros.nodes.viewer.scene import LinkFrames
from tactile_hand_ros.ros.endpoints import subscribe_directly, take_latest
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until

STRAIGHT = [0.0, 0.0, 0.0, 1.0]
FINGERS = ("finger_1", "finger_2", "finger_3")
TOUCH = np.array([[0.1, 0.0, 0.4], [0.0, 0.2, 0.4], [np.nan] * 3])
TURNS = np.array([STRAIGHT, STRAIGHT, [np.nan] * 4])
KINDS = {
    "joint_states": JointState,
    "tactile/contacts": PoseArray,
    "grip_state": JointState,
    "accepted/desired_pose": PoseStamped,
    "ground_truth/object_pose": PoseStamped,
    **{f"tactile/{finger}/wrench": WrenchStamped for finger in FINGERS},
}


class Stage:
    """A viewer, and what it is sent and shows."""

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
def stage() -> Iterator[Stage]:
    with isolated_domain() as domain, private_context(domain) as context:
        made = Stage(context)
        yield made
        made.viewer.destroy_node()
        made.node.destroy_node()


def at(marker: Marker) -> list[float]:
    position = marker.pose.position
    return [position.x, position.y, position.z]


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
    mu = joint_message(["finger_2", "other"], 5, position=[0.5, 0.7])
    stage.send("grip_state", mu)
    shown = stage.show()
    assert at(shown["object"][0]) == [2.0, 0.0, 0.0] and at(shown["goal"][0]) == [2.0, 1.0, 0.0]
    assert [at(ball) for ball in shown["contacts"]] == TOUCH[:2].tolist()
    assert [arrow.points[1].y for arrow in shown["forces"]] == pytest.approx([0.06, 0.12])
    (cone,) = shown["cones"]
    assert cone.id == 1 and cone.points[1].x == pytest.approx(0.06)
    assert {m.header.frame_id for each in shown.values() for m in each} == {"left/palm"}
    assert stage.show() == shown


def test_what_is_no_measurement_is_not_shown(stage: Stage) -> None:
    stage.watch()
    stage.send("tactile/contacts", contacts_message(TOUCH[:2], TURNS[:2], 5))  # of two fingers
    stage.send("ground_truth/object_pose", pose_message([0.0] * 3, [0.0] * 4, 5))  # no rotation
    assert set(stage.show()) == {"all"}
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    wrong = force_message([0.0, np.inf, 0.0], 5, "finger_1_contact")
    stage.send("tactile/finger_1/wrench", wrong)
    assert set(stage.show()) == {"all", "contacts"}


def test_a_best_effort_publisher_is_shown_and_wakes_nobody(stage: Stage) -> None:
    """A QoS event that no executor takes would keep it awake, also after the publisher has left."""
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


def test_the_reliability_of_what_is_shown_can_be_overridden() -> None:
    name = "qos_overrides./joint_states.subscription.reliability"
    with isolated_domain() as domain, private_context(domain) as context:
        made = ViewerNode(context=context, parameter_overrides=[Parameter(name, value="reliable")])
        made.check_ready()
        profiles = {each.topic_name: each.qos_profile for each in made.subscriptions}
        assert profiles["/joint_states"].reliability.name == "RELIABLE"
        made.destroy_node()


def test_with_tf2_links_contacts_and_object_are_transforms(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """tf2_msgs is not among the wheels: the message is one with the field of the same name."""
    sent: list[Any] = []
    assert stage.viewer._tf is None
    values = {pair.key: pair.value for pair in stage.viewer.diagnostics.status().values}
    assert values["tf"] == "tf2_msgs is not installed"
    monkeypatch.setattr(viewer, "TFMessage", SimpleNamespace)
    stage.viewer._tf = SimpleNamespace(publish=sent.append)
    stage.viewer.show()
    assert sent == []  # no joints, no stamp
    hand = Hand.load("paper", "")
    theta = np.linspace(0.1, 0.5, hand.joints)
    order = [*reversed(hand.joint_names[1:]), "other"]  # the first is missing
    angles = [*reversed(theta[1:]), 9.0]
    stage.send("joint_states", joint_message(order, 1_500_000_000, position=angles))
    stage.send("tactile/contacts", contacts_message(TOUCH, TURNS, 5))
    stage.viewer.show()
    theta[0] = 0.0
    links = LinkFrames(hand.description).moving(theta)
    contacts = ["finger_1_contact", "finger_2_contact"]
    expected = [*(link.name for link in links), *contacts]
    assert [t.child_frame_id for t in sent[-1].transforms] == [f"left/{n}" for n in expected]
    for transform, link in zip(sent[-1].transforms, links, strict=False):
        move = transform.transform.translation
        np.testing.assert_allclose([move.x, move.y, move.z], link.position)
        assert (transform.header.stamp.sec, transform.header.stamp.nanosec) == (1, 500_000_000)
    stage.send("ground_truth/object_pose", pose_message([1.0, 0.0, 0.0], STRAIGHT, 5))
    stage.viewer.show()
    assert [t.child_frame_id for t in sent[-1].transforms][-3:] == [
        f"left/{name}" for name in (*contacts, "object")
    ]


def test_with_tf2_what_does_not_move_is_published_once_and_latched(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, sent = list[Any](), list[Any]()

    def create(kind: Any, topic: str, profile: Any) -> Any:
        made.append((kind, topic, profile.durability.name))
        return SimpleNamespace(publish=sent.append, topic=topic)

    monkeypatch.setattr(viewer, "TFMessage", SimpleNamespace)
    monkeypatch.setattr(stage.viewer, "create_publisher", create)
    moving: Any = stage.viewer._publish_static()
    assert made == [
        (SimpleNamespace, "/tf_static", "TRANSIENT_LOCAL"),
        (SimpleNamespace, "/tf", "VOLATILE"),
    ]
    assert moving.topic == "/tf"
    (message,) = sent
    fixed = LinkFrames(Hand.load("paper", "").description).fixed()
    assert [t.child_frame_id for t in message.transforms] == [f"left/{f.name}" for f in fixed]
    stamps = {(t.header.stamp.sec, t.header.stamp.nanosec) for t in message.transforms}
    assert fixed and stamps == {(0, 0)}
