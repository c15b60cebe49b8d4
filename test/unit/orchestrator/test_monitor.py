# SPDX-License-Identifier: Apache-2.0
"""A monitor takes the newest messages of a hand, over real DDS in this process, when asked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from support.messages import pose_message

from tactile_hand_ros.orchestrator.monitor import Monitor, Progress
from tactile_hand_ros.ros.diagnostics import ERROR, OK, STALE, WARN
from tactile_hand_ros.ros.messages import stamp_from_ns
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import TargetConfig

SECOND = 10**9
STRAIGHT = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class Hand:
    """Publishes what the nodes of a hand would publish."""

    def __init__(self, node: Node) -> None:
        self.node = node
        kinds = {
            "joint_command": JointState,
            "auxiliary_pose": PoseStamped,
            "/diagnostics": DiagnosticArray,
        }
        self._publishers = {
            topic: node.create_publisher(kind, topic, QoSProfile(depth=100))
            for topic, kind in kinds.items()
        }

    def meets(self, *topics: str) -> None:
        for topic in topics:
            publisher = self._publishers[topic]
            wait_until(lambda p=publisher: p.get_subscription_count() == 1, message=topic)

    def send(self, topic: str, message: Any) -> None:
        publisher = self._publishers[topic]
        publisher.publish(message)
        assert publisher.wait_for_all_acked()

    def report(self, name: str, level: bytes, message: str = "", **values: object) -> None:
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
        self.send("/diagnostics", DiagnosticArray(status=[status]))

    def answer(self, stamp: int) -> None:
        message = JointState()
        message.header.stamp = stamp_from_ns(stamp)
        self.send("joint_command", message)

    def pose(self, topic: str, x: float, stamp: int) -> None:
        self.send(topic, pose_message([x, 0.2, 0.3], STRAIGHT, stamp))


@pytest.fixture
def hand() -> Iterator[Hand]:
    with isolated_domain() as domain, private_context(domain) as context:
        node = Node("hand", context=context, namespace="/left", start_parameter_services=False)
        yield Hand(node)
        node.destroy_node()


def test_what_the_nodes_say_is_kept_by_node_until_they_say_something_else(hand: Hand) -> None:
    monitor = Monitor(hand.node, [], closely=False)
    hand.meets("/diagnostics")
    assert monitor.facts() == {} and monitor.faults() == [] and monitor.tick == -1
    assert monitor.answered() == -1 and not monitor.is_at_rest
    blank = monitor.progress()
    assert blank.time == 0.0 and math.isnan(blank.position_error) and math.isnan(blank.grasp_force)
    hand.report("/left/plant", OK, "running", answered_ns=3 * SECOND, tick_ns=4 * SECOND, mode="a")
    hand.report("/left/slip_regulator", WARN, "at its limit", grasp_force_n=7.5)
    hand.report(
        "/left/manipulation_controller", ERROR, "no contact", position_error_m=0.25, mode="drive"
    )
    hand.report("/right/plant", STALE, "silent", answered_ns=9 * SECOND)
    assert monitor.progress() == Progress(3.0, 0.25, 7.5, "drive")
    assert monitor.tick == 3 * SECOND
    assert monitor.plant_facts()["mode"] == "a"
    assert monitor.faults() == [
        "/left/manipulation_controller: no contact",
        "/left/slip_regulator: at its limit",
    ]
    hand.report("/left/manipulation_controller", OK)
    assert monitor.faults() == ["/left/slip_regulator: at its limit"]
    assert math.isnan(monitor.progress().position_error)


@pytest.mark.parametrize(
    ("mode", "answered", "rests"),
    [
        ("paused", 4, True),
        ("finished", 4, True),
        ("running", 4, False),
        ("holding", 4, False),
        ("paused", 3, False),
    ],
)
def test_the_plant_rests_when_it_stands_still_and_its_tick_is_answered(
    hand: Hand, mode: str, answered: int, rests: bool
) -> None:
    monitor = Monitor(hand.node, [], closely=False)
    hand.meets("/diagnostics")
    hand.report("/left/plant", OK, mode=mode, tick_ns=4, answered_ns=answered)
    assert monitor.is_at_rest == rests


def test_from_close_by_the_error_is_that_from_the_target_of_the_tick(hand: Hand) -> None:
    targets = [
        TargetConfig(position=(5.0, 0.2, 0.3), time=3.0),
        TargetConfig(position=(2.0, 0.2, 0.3), time=4.0),
    ]
    monitor = Monitor(hand.node, targets, closely=True)
    hand.meets("joint_command", "auxiliary_pose", "/diagnostics")
    assert monitor.answered() == -1 and math.isnan(monitor.progress().position_error)
    for x, second, error in ((1.0, 2, math.nan), (1.5, 3, 3.5), (1.5, 5, 0.5)):
        hand.pose("auxiliary_pose", x, second * SECOND)
        for _ in range(2):  # also without a newer pose
            found = monitor.progress().position_error
            assert found == error or math.isnan(found) and math.isnan(error)
    for second in (2, 2, 1, 7):
        hand.answer(second * SECOND)
        assert monitor.answered() == second * SECOND == monitor.tick
        assert monitor.progress().time == second


def test_from_afar_nothing_of_a_tick_is_subscribed_to(hand: Hand) -> None:
    def topics() -> set[str]:
        return {each.topic_name for each in hand.node.subscriptions}

    Monitor(hand.node, [], closely=False)
    assert topics() == {"/diagnostics"}
    Monitor(hand.node, [], closely=True)
    assert topics() == {"/diagnostics", "/left/joint_command", "/left/auxiliary_pose"}
