# SPDX-License-Identifier: Apache-2.0
"""Single nodes over real DDS: what they say when (13) has no answer or a finger is silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.messages import contacts_message, force_message, pose_message
from support.spinning import spinning

from tactile_hand_ros import names
from tactile_hand_ros.control.targets import MOST_WAITING
from tactile_hand_ros.nodes.force_optimizer import ForceOptimizerNode
from tactile_hand_ros.nodes.manipulation_controller import ManipulationControllerNode
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.nodes.slip_regulator import SlipRegulatorNode
from tactile_hand_ros.ros.diagnostics import ERROR, OK, WARN
from tactile_hand_ros.ros.messages import JointCodec, stamp_to_ns
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant, true_reading

FINGERS = ("finger_1", "finger_2", "finger_3")
TICK = 2_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PLANT = Plant(load_scenario("paper").plant)
TOUCH = true_reading(PLANT.state)
Array = NDArray[np.float64]


class Peer:
    """Plays everybody else: publishes what it is told and keeps what it hears."""

    def __init__(self, context: Context, node: Node) -> None:
        self.node = rclpy.create_node("peer", context=context)
        self.under_test = node
        self.heard: dict[str, list[Any]] = {}
        self.health: list[tuple[bytes, str]] = []
        self.values: dict[str, str] = {}
        self._publishers: dict[str, Any] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)

    def _on_health(self, message: DiagnosticArray) -> None:
        self.health.extend((s.level, s.message) for s in message.status)
        self.values = {pair.key: pair.value for s in message.status for pair in s.values}

    def listen(self, kind: Any, *topics: str) -> None:
        for topic in topics:
            self.heard[topic] = []
            self.node.create_subscription(kind, topic, self.heard[topic].append, 10)

    def speak(self, kind: Any, *topics: str) -> None:
        for topic in topics:
            self._publishers[topic] = self.node.create_publisher(kind, topic, 100)

    def connect(self) -> None:
        """Wait until both sides know of each other."""
        for publisher in self._publishers.values():
            wait_until(lambda p=publisher: p.get_subscription_count() == 1)
        for topic in self.heard:
            ours = f"/{topic}"
            sent = {p.topic_name: p for p in self.under_test.publishers}
            wait_until(lambda o=ours: sent[o].get_subscription_count() == 1)

    def send(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)

    def all_have_arrived(self, topic: str) -> None:
        """Wait until what was sent lies in the queue of the node."""
        assert self._publishers[topic].wait_for_all_acked(Duration(seconds=60))

    def answer(self, topic: str, stamp: int) -> Any:
        """Wait for the message of a tick."""

        def found() -> Any:
            return [m for m in self.heard[topic] if stamp_to_ns(m.header.stamp) == stamp]

        return wait_until(found, message=f"{topic} at {stamp}")[-1]

    def says(self, level: bytes, text: str = "") -> Any:
        return wait_until(
            lambda: [m for got, m in self.health if got == level and text in m], message=text
        )


@pytest.fixture
def meet() -> Iterator[Callable[..., Peer]]:
    """Return a function that makes a node and its peer, served in threads of their own."""
    with isolated_domain() as domain, private_context(domain) as context:
        met: list[Node] = []

        def _meet(kind: type[Node], **parameters: Any) -> Peer:
            overrides = [Parameter(name, value=value) for name, value in parameters.items()]
            peer = Peer(context, kind(context=context, parameter_overrides=overrides))
            met.extend((peer.node, peer.under_test))
            return peer

        yield _meet
        for node in met:
            node.destroy_node()


def contacts(stamp: int, positions: Array = TOUCH.positions) -> PoseArray:
    quaternions = np.where(np.isfinite(positions[:, :1]), TOUCH.quaternions, np.nan)
    return contacts_message(positions, quaternions, stamp)


def without(finger: int) -> Array:
    positions = TOUCH.positions.copy()
    positions[finger] = np.nan
    return positions


def test_who_has_fallen_behind_answers_the_newest_tick(meet: Callable[..., Peer]) -> None:
    """Forty ticks wait for a node that was busy: it answers the newest and the roundest."""
    peer = meet(ForceOptimizerNode)
    topic = names.optimal_force(FINGERS[-1])
    peer.listen(WrenchStamped, topic)
    peer.speak(PoseArray, names.CONTACTS)
    peer.connect()
    for tick in range(41):
        peer.send(names.CONTACTS, contacts(1000 * TICK + tick * TICK))
    peer.all_have_arrived(names.CONTACTS)
    with spinning(peer.under_test, peer.node):
        peer.answer(topic, 1040 * TICK)
        peer.send(names.CONTACTS, contacts(1041 * TICK))
        peer.answer(topic, 1041 * TICK)
    answered = [stamp_to_ns(m.header.stamp) // TICK for m in peer.heard[topic]]
    assert answered == [1000, 1024, 1040, 1041]  # the first of all, of 2048 ms, and the newest
    left_out = {k.value for k in peer.under_test.diagnostics.status().values if "left" in k.key}
    assert left_out == {"38"}


def test_an_optimizer_rejects_minimum_normal_forces_that_exceed_the_grasp_force(
    meet: Callable[..., Peer],
) -> None:
    """What is refused changes nothing, so that the next change is taken as ever."""
    node: Any = meet(ForceOptimizerNode, minimum_normal=0.1).under_test

    def change(name: str, value: Any) -> Any:
        return node.set_parameters([Parameter(name, value=value)])[0]

    refused = change("minimum_normal", 0.335)
    assert not refused.successful
    assert refused.reason == (
        "minimum_normal = 0.335: 3 contacts bear fractions that add up to 1, so that it must be "
        "below 0.333"
    )
    assert node.get_parameter("minimum_normal").value == node.config.minimum_normal == 0.1
    assert change("weights", [1.0, 1.0, 1.0]).successful
    assert change("minimum_normal", 0.33).successful
    assert not [pair for pair in node.diagnostics.status().values if "fault" in pair.key]


def test_the_regulator_is_silent_at_ticks_without_a_finger(meet: Callable[..., Peer]) -> None:
    peer = meet(SlipRegulatorNode)
    wrenches = [names.wrench(name) for name in FINGERS]
    peer.listen(WrenchStamped, names.GRASP_FORCE)
    peer.speak(PoseArray, names.CONTACTS)
    peer.speak(WrenchStamped, *wrenches)

    def feel(stamp: int, *forces: Any) -> None:
        peer.send(names.CONTACTS, contacts(stamp))
        for topic, name, force in zip(wrenches, FINGERS, forces, strict=True):
            if force is not None:
                frame = names.contact_frame(name)
                peer.send(topic, force_message(force, stamp, frame))

    push = (0.0, 3.0, 0.0)
    with spinning(peer.under_test, peer.node):
        peer.connect()
        feel(0, push, push, push)
        assert peer.answer(names.GRASP_FORCE, 0).wrench.force.y == 10.0
        feel(TICK, push, None, push)
        feel(2 * TICK, push, push, (0.0, np.nan, 0.0))
        feel(3 * TICK, push, push, push)
        assert peer.answer(names.GRASP_FORCE, 3 * TICK).wrench.force.y == 10.0
    given = [stamp_to_ns(m.header.stamp) for m in peer.heard[names.GRASP_FORCE]]
    assert given == [0, 3 * TICK]


class ControllersWorld:
    """Everything that a controller hears of a hand that stands still."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self._optimal = [names.optimal_force(name) for name in FINGERS]
        state, joints = PLANT.state, PLANT.hand.joint_names
        self._codec = JointCodec(joints, ("position", "velocity", "effort"))
        self._joints = (state.theta, state.rates, state.torque)
        peer.listen(JointState, names.JOINT_COMMAND)
        peer.listen(PoseStamped, names.AUXILIARY_POSE)
        peer.speak(PoseArray, names.CONTACTS)
        peer.speak(PoseStamped, names.DESIRED_POSE)
        peer.speak(WrenchStamped, names.GRASP_FORCE, *self._optimal)
        peer.speak(JointState, names.JOINT_STATES)

    def tick(self, stamp: int, fraction: float) -> JointState:
        """Let a tick pass, with a normal f* at each finger, and return the command."""
        peer = self.peer
        peer.heard[names.JOINT_COMMAND].clear()
        peer.send(names.JOINT_STATES, self._codec.encode(stamp, *self._joints))
        peer.send(names.CONTACTS, contacts(stamp))
        peer.send(names.GRASP_FORCE, force_message((0.0, 10.0, 0.0), stamp, "palm"))
        for topic, name in zip(self._optimal, FINGERS, strict=True):
            frame = names.contact_frame(name)
            peer.send(topic, force_message((0.0, fraction, 0.0), stamp, frame))
        return peer.answer(names.JOINT_COMMAND, stamp)


@pytest.mark.parametrize(("law", "drives"), [("kawamura", True), ("optimal", False)])
def test_only_the_optimal_law_needs_an_optimal_force(
    meet: Callable[..., Peer], law: str, drives: bool
) -> None:
    peer = meet(ManipulationControllerNode, **{"law.name": law})
    world = ControllersWorld(peer)
    with spinning(peer.under_test, peer.node):
        peer.connect()
        command = world.tick(0, np.nan)
        assert command.name == PLANT.hand.joint_names
        assert bool(np.any(command.effort)) == drives  # no grasp force yet that could be held
        if not drives:
            peer.says(ERROR, "no optimal force")


def test_ticks_that_start_over_forget_all_poses_but_those_sent_meanwhile(
    meet: Callable[..., Peer],
) -> None:
    peer = meet(ManipulationControllerNode)
    world = ControllersWorld(peer)
    centre = TOUCH.positions.mean(axis=0)
    near, far = centre + [0.0, 0.01, 0.0], centre + [0.0, 0.05, 0.0]

    def desire(position: Array) -> None:
        """Command a pose and wait until it was handled: a wrong one behind it was rejected."""
        peer.send(names.DESIRED_POSE, pose_message(position, np.eye(3), 0))
        peer.health.clear()
        peer.send(names.DESIRED_POSE, pose_message(position, np.eye(3), 0, frame="world"))
        peer.says(WARN, "frame_id is 'world'")

    with spinning(peer.under_test, peer.node):
        peer.connect()
        still = list(world.tick(0, 1.0 / 3.0).effort)
        desire(far)
        pulled = list(world.tick(TICK, 1.0 / 3.0).effort)
        assert pulled != still
        assert list(world.tick(0, 1.0 / 3.0).effort) == still
        assert list(world.tick(TICK, 1.0 / 3.0).effort) == still
        desire(near)
        assert list(world.tick(0, 1.0 / 3.0).effort) not in (still, pulled)


DAY = 86_400 * 10**9


def test_a_pose_of_another_clock_is_refused_also_when_it_came_before_the_first_tick(
    meet: Callable[..., Peer],
) -> None:
    """Nobody knows yet what time it is; at the first tick it is too far ahead, if by 1 ns only."""
    peer = meet(ManipulationControllerNode)
    world = ControllersWorld(peer)
    at = TOUCH.positions.mean(axis=0) + [0.0, 0.05, 0.0]
    with spinning(peer.under_test, peer.node):
        peer.connect()
        for stamp in (DAY + 1, DAY + 5 * TICK, DAY + 5 * TICK + 1, 7 * TICK):
            peer.send(names.DESIRED_POSE, pose_message(at, np.eye(3), stamp))
        peer.send(names.DESIRED_POSE, pose_message(at, np.eye(3), 0, frame="world"))
        peer.says(WARN, "frame_id is 'world'")  # so all are handled
        world.tick(5 * TICK, 1.0 / 3.0)
        peer.says(WARN, "is 86400 s ahead of the ticks, which are at 0.010 s")
        assert peer.values["rejected desired_pose"] == "2"
        still = list(world.tick(6 * TICK, 1.0 / 3.0).effort)
        assert list(world.tick(7 * TICK, 1.0 / 3.0).effort) != still
        peer.health.clear()
        peer.send(names.DESIRED_POSE, pose_message(at, np.eye(3), DAY + 7 * TICK))
        peer.send(names.DESIRED_POSE, pose_message(at, np.eye(3), DAY + 7 * TICK + 1))
        wait_until(lambda: peer.values["rejected desired_pose"] == "3")
        kept = [DAY + 1, DAY + 5 * TICK, DAY + 7 * TICK]
        assert peer.under_test._controller.forget_after(0) == kept


def test_poses_that_nobody_fetches_do_not_pile_up(meet: Callable[..., Peer]) -> None:
    """Without ticks, and again when the ticks start over: the latest are kept, the rest counted."""
    peer = meet(ManipulationControllerNode)
    node: Any = peer.under_test
    centre = TOUCH.positions.mean(axis=0)
    for number in range(MOST_WAITING + 3):
        at = centre + [0.0, 1e-5 * number, 0.0]
        node._desired.take(serialize_message(pose_message(at, np.eye(3), (number + 1) * TICK)))
    with spinning(node, peer.node):
        peer.says(WARN, f"more than {MOST_WAITING} poses wait for their tick")
    assert peer.values["dropped_poses"] == peer.values["rejected desired_pose"] == "3"
    kept = [(number + 1) * TICK for number in range(3, MOST_WAITING + 3)]
    assert [stamp for _, stamp in node._desired.fresh] == kept
    node.on_restart()
    assert node._controller.forget_after(0) == kept


def test_who_comes_late_still_gets_the_description_of_the_hand(meet: Callable[..., Peer]) -> None:
    """Though it is published once, before anybody listens."""
    peer = meet(PlantNode, autostart=False)
    heard: list[str] = []
    with spinning(peer.under_test, peer.node):
        peer.says(OK)
        peer.node.create_subscription(
            String, names.ROBOT_DESCRIPTION, lambda m: heard.append(m.data), LATCHED
        )
        wait_until(lambda: heard, message="robot_description")
    assert heard == [PLANT.hand.description]
