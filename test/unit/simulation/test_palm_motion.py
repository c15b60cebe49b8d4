# SPDX-License-Identifier: Apache-2.0
"""A rotating palm: its motion, and the inertial forces on bodies and fingers, computed twice."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from support.plants import after, plant

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_quaternion, rotation_from_vector
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.palm_motion import (
    PalmTurn,
    Turning,
    apparent_wrench,
    palm_turning,
    resting,
    turned_by,
    turned_by_user,
)
from tactile_hand_ros.simulation.plant import Plant

TURNS = [
    PalmTurn(time=0.5, rotation=(0.4, -1.0, 0.3)),
    PalmTurn(time=1.5, rotation=(0.4, -1.0, 0.3)),
    PalmTurn(time=2.5, rotation=(3.0, 0.2, -0.5)),
]


def test_the_palm_is_where_it_should_be_and_rests_there():
    for time, goal in ((0.0, np.zeros(3)), (0.5, TURNS[0].rotation), (9.0, TURNS[2].rotation)):
        rotation, rate, gain = palm_turning(TURNS, time)
        assert_allclose(rotation, rotation_from_vector(goal), atol=1e-12)
        assert_allclose([rate, gain], 0.0, atol=1e-12)


def check_rates(before, at, after, h):
    """Check the rates of a motion against those a time h earlier and later."""
    spin = at.rotation.T @ (after.rotation - before.rotation) / (2.0 * h)
    assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], at.rate, atol=1e-7)
    assert_allclose((after.rate - before.rate) / (2.0 * h), at.acceleration, atol=1e-6)


@pytest.mark.parametrize("time", [0.1, 0.37, 1.0, 1.9, 2.4])
def test_rate_and_acceleration_are_the_derivatives_of_the_way(time):
    h = 1e-5
    check_rates(*(palm_turning(TURNS, time + sign * h) for sign in (-1.0, 0.0, 1.0)), h)


def test_a_free_body_moves_straight_and_keeps_its_angular_momentum_in_the_world():
    h, time, mass = 1e-4, 0.3, 0.3
    place, velocity = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.1, -0.3])
    frame, spin = rotation_from_vector([0.3, 0.2, -0.4]), np.array([1.0, -2.0, 0.5])
    own = frame @ np.diag([1e-3, 2e-3, 2.5e-3]) @ frame.T
    wrench = apparent_wrench(palm_turning(TURNS, time), (mass, own), (place, velocity, spin))
    gain = np.linalg.solve(own, wrench[3:] - np.cross(spin, own @ spin))

    def seen(dt):
        palm, turn = palm_turning(TURNS, time + dt), rotation_from_vector(dt * spin)
        at = place + dt * velocity + 0.5 * dt * dt * wrench[:3] / mass
        momentum = turn @ own @ turn.T @ (palm.rate + spin + dt * gain)
        return palm.rotation @ at, palm.rotation @ momentum

    (before, first), (now, _), (after, last) = (seen(dt) for dt in (-h, 0.0, h))
    assert_allclose(before - 2.0 * now + after, 0.0, atol=1e-5 * h * h * np.linalg.norm(wrench))
    assert_allclose(last - first, 0.0, atol=1e-6 * h)


def test_torques_on_fingers_at_rest_are_the_slope_of_the_centrifugal_potential():
    hand, spin = Hand.load("human"), np.array([2.0, -1.0, 3.0])
    theta, rest = np.array([0.5, 0.1, 0.8, 0.7, -0.2, 0.6, 0.3, 0.2, 1.0]), np.zeros(9)
    model = pin.buildModelFromXML(hand.description, pin.JointModelFreeFlyer())
    data, turns = model.createData(), np.concatenate([np.zeros(3), spin, rest])

    def energy(angles):
        at = np.concatenate([np.zeros(6), [1.0], angles])
        return pin.computeKineticEnergy(model, data, at, turns)

    h = 1e-6
    slope = [(energy(theta + h * e) - energy(theta - h * e)) / (2.0 * h) for e in np.eye(9)]
    assert_allclose(hand.turning_torque(theta, rest, spin, rest[:3]), -np.array(slope), atol=1e-8)
    assert_allclose(hand.turning_torque(theta, rest, rest[:3], rest[:3]), 0.0, atol=1e-15)


def test_torques_by_an_angular_acceleration_are_those_of_links_of_other_lengths():
    hand, gain = Hand.load("paper", link_lengths=1.3), np.array([1.0, 0.5, -0.3])
    theta, rest, data = np.tile([1.047, 0.2, 1.0], 3), np.zeros(9), hand.model.createData()
    pin.computeJointJacobians(hand.model, data, theta)
    expected = np.zeros(9)
    for joint in range(1, hand.model.njoints):
        inertia = data.oMi[joint].act(hand.model.inertias[joint]).matrix()
        momentum = inertia @ np.concatenate([np.zeros(3), gain])
        expected += pin.getJointJacobian(hand.model, data, joint, pin.WORLD).T @ momentum
    found = hand.turning_torque(theta, rest, rest[:3], gain)
    assert_allclose(found, expected, atol=1e-12)


def test_a_free_body_stays_where_it_is_while_the_palm_turns_to_second_order():
    way = [{"time": 0.0, "rotation": [0.0] * 3}, {"time": 0.4, "rotation": [0.4, -1.0, 0.3]}]
    turns = [PalmTurn(**turn) for turn in way]

    def error(step):
        world = plant(step, object__position=(0.3, 0.2, 2.0), palm_motion=way)
        position = after(world, round(0.4 / step)).position
        return np.linalg.norm(palm_turning(turns, 0.4).rotation @ position - [0.3, 0.2, 2.0])

    coarse, fine = error(2e-3), error(1e-3)
    assert fine < 2e-4 and coarse / fine == pytest.approx(4.0, rel=0.1)


def test_gravity_acts_in_the_orientation_of_a_palm_at_rest():
    turned = {"plant.palm_motion": [{"time": 0.0, "rotation": [1.2, 0.3, 0.0]}], "duration": 0.1}
    found = ClosedLoop(load_scenario("hold", turned)).run()
    down = rotation_from_vector([1.2, 0.3, 0.0]).T @ [0.0, 0.0, -9.81]
    same = ClosedLoop(load_scenario("hold", {"gravity": down.tolist(), "duration": 0.1})).run()
    assert_allclose(found.theta, same.theta, atol=1e-9)
    assert_allclose(found.command, same.command, atol=1e-6)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("palm_motion", [TURNS[0].model_dump()] * 2, "expected each after the last"),
        ("palm_turn", [0.1, 0.0, 0.0], "without palm_motion the hand has no imu"),
    ],
)
def test_turns_in_no_order_or_without_an_imu_are_refused(key, value, message):
    with pytest.raises(ConfigurationError, match=message):
        load_scenario("hold", {f"plant.{key}": value})


def test_a_user_turns_the_palm_on_top_of_its_motion_with_the_right_rates():
    now, h = resting(np.eye(3)), 1e-5
    for _ in range(300):
        now = turned_by_user(now, (0.5, 1.0, -0.2), 1e-3)
    reached = []
    for sign in (-1.0, 0.0, 1.0):
        turn = sign * h * (now.rate + 0.5 * sign * h * now.acceleration)
        rate = now.rate + sign * h * now.acceleration
        moved = Turning(now.rotation @ rotation_from_vector(turn), rate, now.acceleration)
        reached.append(turned_by(moved, palm_turning(TURNS, 0.3 + sign * h)))
    check_rates(*reached, h)


def test_a_palm_follows_a_user_within_a_second_and_its_hand_knows():
    config = load_scenario("hold", {"plant.palm_motion": [{"time": 0.0, "rotation": [0.0] * 3}]})
    plant = Plant(config.plant)
    plant.configure(config.plant.changed({"palm_turn": (1.2, 0.3, 0.0)}))
    state = after(plant, round(1.2 * config.plant.rate))
    goal = rotation_from_vector([1.2, 0.3, 0.0])
    assert_allclose(rotation_from_quaternion(state.palm), goal, atol=0.03)
    assert_allclose(plant.model.gravity, goal.T @ np.array(config.plant.gravity), atol=0.3)
    assert plant.reset().palm == pytest.approx([0.0, 0.0, 0.0, 1.0])
