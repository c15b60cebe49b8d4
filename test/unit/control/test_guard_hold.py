# SPDX-License-Identifier: Apache-2.0
"""The hold brakes smoothly, is stable at every tick, and raises the grasp force with the load."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tactile_hand_ros.control.holds import (
    GuardHold,
    GuardHoldConfig,
    JointTerms,
    joint_torque,
    tip_forces,
)
from tactile_hand_ros.hand.hand import Hand

HAND = Hand.load("paper")
THETA = np.tile([1.047, 0.0, 1.571], 3)
STILL = np.zeros(9)
TIPS = HAND.fingertips(THETA)
# Towards the middle of the tips: forces in balance that only press the tips together.
INTERNAL = 8.0 * (TIPS.positions.mean(axis=0) - TIPS.positions)
PRESSED = joint_torque(TIPS, INTERNAL)


def hold(tick=0.002, **changes) -> GuardHold:
    return GuardHold(GuardHoldConfig().changed(changes), HAND, tick)


def terms(theta, rates) -> JointTerms:
    return JointTerms(*HAND.dynamics(theta, rates))


@pytest.mark.parametrize("tick", [0.0005, 0.001, 0.002, 0.005, 0.01])
def test_a_moving_free_hand_comes_to_rest_and_stays(tick):
    """Stable at every rate, also when joint states are a tick old."""
    made, theta, rates = hold(tick), THETA, np.linspace(-0.5, 0.5, 9)
    made.engage(theta, rates, STILL)
    waiting = [np.zeros(9)]
    for _ in range(round(1.0 / tick)):
        model = terms(theta, rates)
        waiting.append(made.step(theta, rates, model, STILL))
        rates = rates + tick * np.linalg.solve(model.inertia, waiting.pop(0) - model.bias)
        theta = theta + tick * rates
    assert_allclose(rates, 0.0, atol=1e-4)
    assert np.abs(theta - THETA).max() < 0.012


def test_braking_begins_without_a_step_of_the_torque():
    made, rates = hold(), np.linspace(-0.5, 0.5, 9)
    made.engage(THETA, rates, STILL)
    model = terms(THETA, rates)
    assert_allclose(made.step(THETA, rates, model, STILL), model.bias, atol=1e-12)


def grasp_force_under(made, load: float, ticks: int = 50) -> float:
    """Return how many times the first grasp force the hold answers to a load on each tip [N]."""
    made.engage(THETA, STILL, PRESSED)
    pressed = PRESSED + joint_torque(TIPS, np.tile([0.0, 0.0, load], (3, 1)))
    for _ in range(ticks):
        torque = made.step(THETA, STILL, terms(THETA, STILL), pressed)
    return float(torque @ PRESSED / (PRESSED @ PRESSED))


def test_the_grasp_force_grows_with_the_load_and_never_falls():
    total = np.linalg.norm(INTERNAL, axis=1).sum()
    made = hold(reserve=0.0, friction=0.5)
    assert grasp_force_under(made, -1.0) == pytest.approx(1.0 + 3.0 / (0.5 * total), rel=1e-3)
    torque = made.step(THETA, STILL, terms(THETA, STILL), PRESSED)
    assert torque @ PRESSED / (PRESSED @ PRESSED) > 1.0 + 2.7 / (0.5 * total)


def test_the_grasp_force_ends_at_its_limit_and_at_the_joints():
    total = np.linalg.norm(INTERNAL, axis=1).sum()
    limited = hold(squeeze_limit=1.5 * total)
    assert grasp_force_under(limited, -50.0) == pytest.approx(1.5, rel=1e-6)
    above = hold(squeeze_limit=0.5 * total)
    assert grasp_force_under(above, -50.0) == pytest.approx(1.0)
    joints = grasp_force_under(hold(squeeze_limit=1e4), -500.0)
    assert joints * np.abs(PRESSED).max() == pytest.approx(HAND.effort_limits.max(), rel=1e-6)


def test_fingers_that_do_not_press_are_not_made_to():
    made = hold()
    made.engage(THETA, STILL, STILL)
    load = joint_torque(TIPS, np.tile([0.0, 0.0, -5.0], (3, 1)))
    assert_allclose(made.step(THETA, STILL, terms(THETA, STILL), load), 0.0, atol=1e-12)


@pytest.mark.parametrize(("tick", "bandwidth"), [(0.002, 100.0), (0.005, 50.0), (0.0025, 100.0)])
def test_a_posture_returns_like_a_critically_damped_spring_no_faster_than_the_ticks_allow(
    tick, bandwidth
):
    made, rates, off = hold(tick, reserve=0.0), np.linspace(-0.5, 0.4, 9), np.linspace(0.0, 0.01, 9)
    made.engage(THETA, STILL, PRESSED)
    model = terms(THETA + off, rates)
    wanted = -2.0 * bandwidth * rates - bandwidth**2 * off
    found = made.step(THETA + off, rates, model, None)
    assert_allclose(found, PRESSED + model.bias + model.inertia @ wanted, rtol=1e-12)


def test_moving_joints_follow_a_smooth_way_to_rest():
    """With q' = v (1 + x) exp(-x), x = t / T: here integrated and differentiated by steps."""
    made, start = hold(0.002, stopping_time=0.004), np.linspace(-0.5, 0.5, 9)
    made.engage(THETA, start, STILL)
    time = np.linspace(0.0, 0.02, 20001)
    speed = (1.0 + time / 0.004) * np.exp(-time / 0.004)
    way = np.concatenate([[0.0], np.cumsum(0.5e-6 * (speed[1:] + speed[:-1]))])
    slope = np.gradient(speed, time)
    model = terms(THETA, STILL)
    for tick in range(6):
        at = 2000 * tick
        factor = slope[at] + 200.0 * speed[at] + 1e4 * way[at]
        found = np.linalg.solve(model.inertia, made.step(THETA, STILL, model, None) - model.bias)
        tolerance = 0.2 if tick == 0 else 1e-3
        assert_allclose(found, factor * start, rtol=1e-5, atol=tolerance)


def test_a_load_is_felt_with_its_time_constant():
    """5 ms: after n ticks of 2 ms 1 - exp(-0.4 n) of it is there."""
    total = np.linalg.norm(INTERNAL, axis=1).sum()
    for ticks in (1, 2, 5):
        made = hold(reserve=0.0, friction=0.5)
        felt = 3.0 * (1.0 - np.exp(-0.4 * ticks))
        expected = 1.0 + felt / (0.5 * total)
        force = made.engage(THETA, STILL, PRESSED) or grasp_force_under(made, -1.0, ticks)
        assert force == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("total", [0.049, 0.051])
def test_a_twentieth_of_a_newton_in_all_is_the_least_grasp_force(total):
    share = total / np.linalg.norm(INTERNAL, axis=1).sum()
    made = hold(reserve=0.5)
    made.engage(THETA, STILL, share * PRESSED)
    pressed = share * PRESSED + joint_torque(TIPS, np.tile([0.0, 0.0, -2.0], (3, 1)))
    found = made.step(THETA, STILL, terms(THETA, STILL), pressed)
    grown = 6.0 * (1.0 - np.exp(-0.4))
    factor = 1.0 if total < 0.05 else max(1.5, 1.0 + grown / (0.2 * total))
    assert_allclose(found, factor * share * PRESSED, rtol=1e-9, atol=1e-12)


def test_the_grasp_force_is_kept_in_the_room_that_each_joint_has():
    """Of which one presses already; a joint without torque of the internal force limits nothing."""
    load = joint_torque(TIPS, np.tile([0.0, 0.0, 3.0], (3, 1)))
    made = hold(reserve=2.0, squeeze_limit=1e4)
    made.engage(THETA, STILL, 4.0 * PRESSED + load)
    room = HAND.effort_limits - np.abs(4.0 * PRESSED + load)
    moved = np.abs(4.0 * PRESSED)
    most = 1.0 + np.min(room[moved > 1e-9] / moved[moved > 1e-9])
    found = made.step(THETA, STILL, terms(THETA, STILL), None)
    assert_allclose(found, 4.0 * PRESSED + load + (min(3.0, most) - 1.0) * 4.0 * PRESSED, atol=1e-9)
    heavy = 15.0 / np.abs(PRESSED).max()
    made.engage(THETA, STILL, heavy * PRESSED)
    found = made.step(THETA, STILL, terms(THETA, STILL), None)
    assert np.abs(found).max() == pytest.approx(HAND.effort_limits.max())


def test_it_brakes_again_from_another_posture_with_the_grasp_force_as_it_is():
    made = hold(reserve=0.5)
    made.engage(THETA, np.full(9, 0.1), PRESSED)
    for _ in range(3):
        made.step(THETA, STILL, terms(THETA, STILL), None)
    other = THETA + 0.02
    made.brake(other, STILL)
    found = made.step(other, STILL, terms(other, STILL), None)
    assert_allclose(found, 1.5 * PRESSED, atol=1e-9)


def test_a_finger_that_is_nearly_straight_is_not_asked_for_forces_that_no_joint_makes():
    """Along it a torque of rounding would be a force of mega-newtons."""
    straight = THETA.copy()
    straight[2] = 1e-8
    tips = HAND.fingertips(straight)
    forces = tip_forces(tips, PRESSED)
    assert np.abs(forces).max() < 50.0
    other = straight.copy()
    other[2] = 1e-3
    found = tip_forces(HAND.fingertips(other), PRESSED)
    assert_allclose(joint_torque(HAND.fingertips(other), found), PRESSED, atol=1e-9)
