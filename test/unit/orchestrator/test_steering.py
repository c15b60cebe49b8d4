# SPDX-License-Identifier: Apache-2.0
"""The orchestrator's commands arrive with their times; a plant's rejection is an error."""

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

from tactile_hand_ros.orchestrator.steering import Steering, SteeringError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.messages import PoseCodec, stamp_to_ns
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.scenario.scenario import TargetConfig, UserForceConfig, load_scenario

TARGETS = [
    TargetConfig(position=(0.1, 0.2, 0.3)),
    TargetConfig(position=(0.4, 0.5, 0.6), rotation=(0.0, 0.0, 0.25), time=1.5),
]
FORCES = [UserForceConfig(time=time, force=1.0 + time) for time in (2.0, 0.0, 1.0)]
SCENARIO = load_scenario("paper").model_copy(update={"targets": TARGETS, "user_forces": FORCES})


@pytest.fixture
def make(context: Context) -> Iterator[Callable[[str], Node]]:
    made: list[Node] = []

    def _make(name: str) -> Node:
        made.append(Node(name, context=context, start_parameter_services=False))
        return made[-1]

    yield _make
    for node in made:
        node.destroy_node()


def test_targets_and_the_newest_force_that_is_due_arrive(make):
    hand, heard, forces = make("hand"), list[Any](), list[float]()
    hand.create_subscription(PoseStamped, "desired_pose", heard.append, qos.user_qos())
    hand.create_subscription(
        Float64, "user_grasp_force", lambda message: forces.append(message.data), qos.user_qos()
    )
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
            wait_until(lambda e=expected: forces == e)
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
    class Trouble(Exception):
        pass

    def check() -> None:
        raise Trouble

    steering = Steering(make("orchestrator"), SCENARIO, check)
    with pytest.raises(SteeringError, match=r"did not answer to ~/run within 0\.03 s"):
        steering.run(True, timeout=0.03, check=False)
    with pytest.raises(Trouble):
        steering.run(True)
