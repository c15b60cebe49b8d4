# SPDX-License-Identifier: Apache-2.0
"""The orchestrator's commands arrive with their times; a plant that refuses is an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from std_srvs.srv import SetBool
from support.spinning import spinning

from tactile_hand_ros.orchestrator.steering import (
    Steering,
    SteeringError,
    UserForces,
    how_to_steer,
)
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec, stamp_to_ns
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.scenario.scenario import TargetConfig, UserForceConfig

TARGETS = [
    TargetConfig(position=(0.1, 0.2, 0.3)),
    TargetConfig(position=(0.4, 0.5, 0.6), rotation=(0.0, 0.0, 0.25), time=1.5),
]


@pytest.fixture
def context() -> Iterator[Context]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture
def make(context: Context) -> Iterator[Callable[[str], Node]]:
    made: list[Node] = []

    def _make(name: str) -> Node:
        made.append(Node(name, context=context, start_parameter_services=False))
        return made[-1]

    yield _make
    for node in made:
        node.destroy_node()


def no_check() -> None:
    """Find nothing wrong."""


def test_targets_and_forces_arrive_in_order(make: Callable[[str], Node]) -> None:
    hand, heard = make("hand"), list[Any]()
    for kind, topic in ((PoseStamped, "desired_pose"), (Float64, "user_grasp_force")):
        hand.create_subscription(kind, topic, heard.append, qos.user_qos())
    steering = Steering(make("orchestrator"), no_check)
    assert not steering.is_ready
    keys = ("publications /desired_pose", "publications /user_grasp_force")
    wait_until(lambda: list(steering.facts.values()) == ["1", "1"])
    assert tuple(steering.facts) == keys
    with spinning(hand):
        steering.command(TARGETS)
        steering.grasp_force(UserForceConfig(time=2.0, force=8.5))
        wait_until(lambda: len(heard) == 3)
    assert [stamp_to_ns(pose.header.stamp) for pose in heard[:2]] == [0, 1_500_000_000]
    for pose, target in zip(heard, TARGETS, strict=False):
        got, sent = PoseCodec().decode(serialize_message(pose))[1], target.target()
        np.testing.assert_allclose(got.position, sent.position)
        rotation = rotation_from_quaternion(got.quaternion)
        np.testing.assert_allclose(rotation, sent.orientation, atol=1e-12)
    assert heard[2].data == 8.5


@pytest.mark.parametrize("accepts", [True, False])
def test_the_plant_is_told_to_run_and_its_refusal_is_an_error(
    make: Callable[[str], Node], accepts: bool
) -> None:
    plant, asked = make("plant"), list[bool]()

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append(request.data)
        response.success, response.message = accepts, "it is finished"
        return response

    plant.create_service(SetBool, "plant/run", answer)
    steering = Steering(make("orchestrator"), no_check)
    wait_until(lambda: steering.is_ready)
    with spinning(plant):
        if accepts:
            steering.run(True)
            steering.run(False)
        else:
            with pytest.raises(SteeringError, match="refuses ~/run: it is finished"):
                steering.run(True)
    assert asked == ([True, False] if accepts else [True])


def test_a_plant_without_an_answer_is_not_awaited_for_ever(make: Callable[[str], Node]) -> None:
    class Trouble(Exception):
        pass

    def check() -> None:
        raise Trouble

    steering = Steering(make("orchestrator"), check)
    with pytest.raises(SteeringError, match=r"did not answer to ~/run within 0\.03 s"):
        steering.run(True, timeout=0.03, check=False)
    with pytest.raises(Trouble):
        steering.run(True)


FORCES = [
    UserForceConfig(time=2.0, force=3.0),
    UserForceConfig(time=0.0, force=1.0),
    UserForceConfig(time=1.0, force=2.0),
]


def test_user_forces_are_sent_when_their_time_has_come_the_newest_of_those_due() -> None:
    sent: list[float] = []
    asking = UserForces(FORCES, lambda request: sent.append(request.force))
    assert asking.is_due_later
    asking.step(-1)
    assert sent == []
    asking.step(0)
    assert sent == [1.0] and asking.is_due_later
    asking.step(999_999_999)
    assert sent == [1.0]
    asking.step(1_000_000_000)
    assert sent == [1.0, 2.0]
    asking.step(3_000_000_000)
    asking.step(4_000_000_000)
    assert sent == [1.0, 2.0, 3.0] and not asking.is_due_later
    late: list[float] = []
    UserForces(FORCES, lambda request: late.append(request.force)).step(1_000_000_000)
    assert late == [2.0]


def test_a_user_force_at_the_start_is_not_due_later() -> None:
    assert not UserForces(FORCES[1:2], lambda _: None).is_due_later
    soon = UserForceConfig(time=1e-9, force=1.0)
    assert soon.stamp == 1 and UserForces([soon], lambda _: None).is_due_later


@pytest.mark.parametrize(("namespace", "tail"), [("/", ""), ("/left", " --namespace /left")])
def test_the_command_to_steer_names_the_hand_and_a_target_of_its_own(
    namespace: str, tail: str
) -> None:
    assert how_to_steer(namespace, TARGETS) == f"tactile-hand move 0.4 0.5 0.6{tail}"
    assert how_to_steer(namespace, []) == f"tactile-hand move X Y Z{tail}"
