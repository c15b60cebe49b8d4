# SPDX-License-Identifier: Apache-2.0
"""Hands that exist hold a cube under a pull, and those that can move and turn it first."""

import pytest

from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import load_scenario

HANDS = "allegro shadow dex3 ability panda".split()
THREE_AXES = {  # as if the skin of the Ability Hand measured them
    "tactile_sensor.axes": "all",
    "slip_regulator.mode": "auto",
    "slip_regulator.grasp_force": 8.66,
    "manipulation_controller.law.name": "optimal",
    "manipulation_controller.law.observer.time": 0.1,
    "manipulation_controller.law.integral.time": 0.5,
    "manipulation_controller.law.integral.force_limit": 5.0,
}


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_that_exists_keeps_its_cube_under_a_pull(name):
    scenario, result = load_scenario(name), simulate(name)
    metrics = result.metrics
    assert scenario.plant.disturbances[-1].force[2] == -2.0
    assert metrics.goal_reached and metrics.contacts_lost_ticks == 0
    assert metrics.max_slip_distance_m < 1e-3 and metrics.slip_alarm_count <= 1
    commands = [event for event in result.events if event.kind == "command"]
    assert len(commands) == (2 if name in ("allegro", "shadow") else 0)


def test_a_gripper_refuses_to_move_its_object_and_says_why():
    target = {"time": 0.5, "position": [0.005, 0.0, 0.1034]}
    with pytest.raises(PoseError, match="left would stay 5 mm short of its contact"):
        check_scenario(load_scenario("panda", {"targets": [target]}))


def test_a_hand_with_few_motions_keeps_its_posture_by_a_spring_between_joints():
    """A pose that is seen by touch, noisy and late, would shake the object by 8 mm."""
    record = simulate("ability", THREE_AXES).record
    before = record.object_position[(record.times > 1.0) & (record.times < 2.0)]
    assert abs(before - before.mean(axis=0)).max() < 3e-4
