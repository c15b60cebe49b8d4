# SPDX-License-Identifier: Apache-2.0
"""Commands of users and of the orchestrator arrive, and their own answers return."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
from support.messages import force_message, pose_message, stamp_to_ns
from support.nodes import spinning

from bench.processes import isolated_domain
from tactile_hand_ros import names
from tactile_hand_ros.orchestrator import steering as module
from tactile_hand_ros.orchestrator.steering import HandClient, Steering, SteeringError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec
from tactile_hand_ros.ros.middleware import graph_node, ros_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.scenario.scenario import TargetConfig, UserForceConfig, load_scenario

STAMP = 12_500_000_000
NOW = Rotation.from_euler("xyz", [0.3, -0.5, 1.1])
OTHER = pose_message((9.0, 9.0, 9.0), np.eye(3), 1)


class Hand:
    """A user's view of a hand that accepts or rejects commands as configured."""

    def __init__(self, context: Context, namespace: str, *, plant: bool) -> None:
        self.node = node = Node("hand", context=context, namespace=namespace)
        self.reason: str | None = ""  # why commands are rejected, empty if they are accepted
        self.ignored = 0  # number of commands whose answer is lost
        self.poses: list[PoseStamped] = []
        self.forces: list[float] = []
        self.calls: list[tuple[str, Any]] = []
        make, user = node.create_publisher, qos.USER_DEPTH
        self._answers = {
            names.DESIRED_POSE: make(PoseStamped, names.ACCEPTED_POSE, user),
            names.USER_GRASP_FORCE: make(WrenchStamped, names.ACCEPTED_FORCE, user),
        }
        self._refusals = {
            names.DESIRED_POSE: make(DiagnosticArray, names.rejected(names.CONTROLLER), user),
            names.USER_GRASP_FORCE: make(DiagnosticArray, names.rejected(names.REGULATOR), user),
        }
        node.create_subscription(PoseStamped, names.DESIRED_POSE, self._on_pose, user)
        node.create_subscription(Float64, names.USER_GRASP_FORCE, self._on_force, user)
        resets = [names.CONTROLLER, names.REGULATOR, *([names.PLANT] if plant else [])]
        services = {f"{names.CONTROLLER}/grasp": SetBool, **{f"{n}/reset": Trigger for n in resets}}
        for name, kind in services.items():
            node.create_service(kind, name, self._service(name))

    def _on_pose(self, message: PoseStamped) -> None:
        self.poses.append(message)
        point, turn = message.pose.position, message.pose.orientation
        q = NOW.as_quat() if np.isnan(turn.w) else [turn.x, turn.y, turn.z, turn.w]
        accepted = pose_message((point.x, point.y, point.z), np.array(q), STAMP)
        self._answer(names.DESIRED_POSE, accepted, OTHER)

    def _on_force(self, message: Float64) -> None:
        self.forces.append(message.data)
        accepted = force_message((0.0, message.data, 0.0), STAMP, "palm")
        other = force_message((0.0, message.data + 1.0, 0.0), 1, "palm")
        self._answer(names.USER_GRASP_FORCE, accepted, other)

    def _answer(self, topic: str, accepted: Any, other: Any) -> None:
        """Publish the answer to a command after the answer to another user."""
        self._answers[topic].publish(other)
        if self.ignored:
            self.ignored -= 1
        elif self.reason == "":
            self._answers[topic].publish(accepted)
        else:
            values = [KeyValue(key="other", value="of another topic")]
            values += [KeyValue(key=topic, value=self.reason)] if self.reason else []
            status = DiagnosticStatus(values=values)
            self._refusals[topic].publish(DiagnosticArray(status=[status]))

    def _service(self, name: str) -> Any:
        def answer(request: Any, response: Any) -> Any:
            self.calls.append((name, getattr(request, "data", None)))
            response.success, response.message = self.reason == "", self.reason or f"done: {name}"
            return response

        return answer


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    with isolated_domain() as number, ros_context(domain=number) as own:
        yield own


@pytest.fixture(scope="module")
def served(context: Context) -> Iterator[dict[str, Hand]]:
    """Serve a simulated hand without a namespace, and a real one, which has no plant."""
    hands = {"": Hand(context, "/", plant=True), "real": Hand(context, "/real", plant=False)}
    senders = [
        Node(names.PLANT, context=context, namespace="/"),
        Node("driver", context=context, namespace="/real"),
    ]
    for sender in senders:
        sender.create_publisher(JointState, names.JOINT_STATES, qos.TICK_DEPTH)
    with spinning(*(hand.node for hand in hands.values())):
        yield hands
    for node in (*senders, *(hand.node for hand in hands.values())):
        node.destroy_node()


@pytest.fixture
def hand(served: dict[str, Hand]) -> Hand:
    """Return the simulated hand in its initial state."""
    for each in served.values():
        each.reason, each.ignored = "", 0
        each.poses, each.forces, each.calls = [], [], []
    return served[""]


@pytest.fixture
def client(context: Context) -> Iterator[HandClient]:
    with graph_node(context, "user", "/") as node:
        yield HandClient(node, 30.0)


@pytest.mark.parametrize("turn", [[0.1, -0.2, 0.3], None])
def test_a_pose_is_asked_for_once_and_may_keep_the_orientation_of_the_grasp(hand, client, turn):
    since, vector = client.move([0.1, 0.2, 0.3], turn)
    wanted = NOW if turn is None else Rotation.from_rotvec(turn)
    [message] = hand.poses
    point, q = message.pose.position, message.pose.orientation
    assert since == pytest.approx(12.5) and (point.x, point.y, point.z) == (0.1, 0.2, 0.3)
    assert (Rotation.from_rotvec(vector) * wanted.inv()).magnitude() < 1e-9
    sent = [q.x, q.y, q.z, q.w]
    assert np.isnan(sent).all() == (turn is None)
    assert turn is None or (Rotation.from_quat(sent) * wanted.inv()).magnitude() < 1e-9
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)  # immediately


def test_a_force_has_the_time_at_which_it_takes_effect(hand, client):
    assert client.grasp_force(7.25) == pytest.approx(12.5)
    assert hand.forces == [7.25]


def test_what_stays_without_an_answer_is_sent_again(hand, client, monkeypatch):
    monkeypatch.setattr(module, "_AGAIN", 0.05)
    hand.ignored = 2
    assert client.grasp_force(3.0) == pytest.approx(12.5)
    assert hand.forces[:3] == [3.0, 3.0, 3.0]


def test_a_refusal_says_why(hand, client):
    hand.reason = "too far"
    for command in (
        lambda: client.move([0.0, 0.0, 0.0], None),
        lambda: client.grasp_force(7.0),
        lambda: client.grasp(True),
    ):
        with pytest.raises(SteeringError, match="the hand rejects the command: too far$"):
            command()
    hand.reason = None
    with pytest.raises(SteeringError, match="the hand rejects the command: no reason given$"):
        client.grasp_force(7.0)


def test_fingers_are_closed_and_opened_and_a_simulation_begins_at_its_start(hand, client):
    assert client.grasp(True) == f"done: {names.CONTROLLER}/grasp"
    client.grasp(False)
    assert client.reset() == "time, hand and object are back at the start"
    grasp = f"{names.CONTROLLER}/grasp"
    assert hand.calls == [(grasp, True), (grasp, False), (f"{names.PLANT}/reset", None)]


def test_a_real_hand_begins_with_its_present_grasp(hand, served, context):
    with graph_node(context, "user", "/real") as node:
        assert HandClient(node, 30.0).reset() == "done: manipulation_controller/reset"
    called = [name for name, _ in served["real"].calls]
    assert called == ["slip_regulator/reset", "manipulation_controller/reset"]
    assert hand.calls == []


def test_a_hand_that_is_paused_does_not_answer(hand, client, context):
    client.grasp_force(1.0)  # now everything has been discovered
    hand.ignored, hand.forces = 100, []
    with graph_node(context, "user", "/") as node:
        with pytest.raises(SteeringError, match="has not answered within 0.5 s; if it is paused"):
            HandClient(node, 0.5).grasp_force(2.0)
    assert len(hand.forces) == 1


def test_nothing_is_reset_before_the_controller_is_there_and_the_sender_of_joints_is_known(make):
    """If the plant is discovered late, a partial reset must not be reported as a reset."""
    half, node, called = make("half"), make("user"), list[str]()

    def reset(name: str, _: Any, response: Trigger.Response) -> Trigger.Response:
        called.append(name)
        response.success = True
        return response

    half.create_service(Trigger, f"{names.PLANT}/reset", partial(reset, names.PLANT))
    with spinning(half):
        with pytest.raises(SteeringError, match="no hand is"):
            HandClient(node, 0.3).reset()
        for name in (names.CONTROLLER, names.REGULATOR):
            half.create_service(Trigger, f"{name}/reset", partial(reset, name))
        with pytest.raises(SteeringError, match="joint_states has no publisher"):
            HandClient(node, 3.0).reset()
        assert called == []
        make(names.PLANT).create_publisher(JointState, names.JOINT_STATES, qos.TICK_DEPTH)
        HandClient(node, 30.0).reset()
        assert called == [names.PLANT]


TARGETS = [
    TargetConfig(position=(0.1, 0.2, 0.3)),
    TargetConfig(position=(0.4, 0.5, 0.6), rotation=(0.0, 0.0, 0.25), time=1.5),
]
FORCES = [UserForceConfig(time=time, force=1.0 + time) for time in (2.0, 0.0, 1.0)]
SCENARIO = load_scenario("paper").model_copy(update={"targets": TARGETS, "user_forces": FORCES})


@pytest.fixture
def make(there: Context) -> Iterator[Callable[[str], Node]]:
    """Return a function that makes nodes in a domain without the hands of other tests."""
    made: list[Node] = []

    def _make(name: str) -> Node:
        made.append(Node(name, context=there, start_parameter_services=False))
        return made[-1]

    yield _make
    for node in made:
        node.destroy_node()


def test_targets_and_the_newest_force_that_is_due_arrive(make):
    hand, heard, forces = make("hand"), list[Any](), list[Float64]()
    hand.create_subscription(PoseStamped, "desired_pose", heard.append, qos.USER_DEPTH)
    hand.create_subscription(Float64, "user_grasp_force", forces.append, qos.USER_DEPTH)
    steering = Steering(make("orchestrator"), SCENARIO, lambda: None)
    assert not steering.is_ready
    wait_until(lambda: list(steering.facts.values()) == ["1", "1"])
    keys = ("publications /desired_pose", "publications /user_grasp_force")
    assert tuple(steering.facts) == keys
    with spinning(hand):
        steering.send_targets()
        wait_until(lambda: len(heard) == 2)
        for second, expected in ((-1, []), (0, [1.0]), (0.9, [1.0]), (3, [1.0, 3.0]), (4, [1, 3])):
            steering.send_forces(round(second * 1e9))
            wait_until(lambda e=expected: [message.data for message in forces] == e)
    assert [stamp_to_ns(pose.header.stamp) for pose in heard] == [0, 1_500_000_000]
    for pose, target in zip(heard, TARGETS, strict=True):
        got, sent = PoseCodec(nan_allowed=True).decode(serialize_message(pose))[1], target.target()
        np.testing.assert_allclose(got.position, sent.position)
        rotation = rotation_from_quaternion(got.quaternion)
        np.testing.assert_allclose(rotation, sent.orientation, atol=1e-12)


@pytest.mark.parametrize("accepts", [True, False])
def test_the_plant_is_told_to_run_and_its_refusal_is_an_error(make, accepts):
    plant, asked = make("plant"), list[bool]()

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append(request.data)
        response.success, response.message = accepts, "it is finished"
        return response

    plant.create_service(SetBool, "plant/run", answer)
    steering = Steering(make("orchestrator"), SCENARIO, lambda: None)
    wait_until(lambda: steering.is_ready)
    with spinning(plant):
        if accepts:
            steering.run(True)
            steering.run(False)
        else:
            with pytest.raises(SteeringError, match="rejects ~/run: it is finished"):
                steering.run(True)
    assert asked == ([True, False] if accepts else [True])


def test_a_plant_without_an_answer_is_not_awaited_for_ever(make):
    steering = Steering(make("orchestrator"), SCENARIO, Mock(side_effect=ZeroDivisionError))
    with pytest.raises(SteeringError, match=r"did not answer to ~/run within 0\.03 s"):
        steering.run(True, timeout=0.03, check=False)
    with pytest.raises(ZeroDivisionError):
        steering.run(True)
