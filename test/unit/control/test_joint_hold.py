# SPDX-License-Identifier: Apache-2.0
"""The hold brakes smoothly, is stable at every tick, and squeezes with the load."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tactile_hand_ros.control.joint_hold import (
    JointHold,
    JointHoldConfig,
    JointTerms,
    joint_torque,
    split_forces,
    tip_forces,
)
from tactile_hand_ros.hand.hand import Hand

HAND = Hand.load("paper")
THETA = np.tile([1.047, 0.0, 1.571], 3)
STILL = np.zeros(9)
TIPS = HAND.fingertips(THETA)
# Towards the middle of the tips: forces in balance that only squeeze.
SQUEEZE = 8.0 * (TIPS.positions.mean(axis=0) - TIPS.positions)
PRESSED = joint_torque(TIPS, SQUEEZE)


def hold(tick=0.002, **changes) -> JointHold:
    return JointHold(JointHoldConfig().changed(changes), HAND, tick)


def terms(theta, rates) -> JointTerms:
    return JointTerms(*HAND.dynamics(theta, rates))


def test_tip_forces_are_those_of_the_torque():
    assert_allclose(tip_forces(TIPS, PRESSED), SQUEEZE, atol=1e-12)


def test_a_load_is_told_from_a_squeeze():
    load = np.tile([0.0, 0.0, -2.0], (3, 1))
    carried, squeezing = split_forces(SQUEEZE + load)
    assert_allclose(carried, [0.0, 0.0, -6.0], atol=1e-12)
    assert_allclose(squeezing, SQUEEZE, atol=1e-12)


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


def test_the_squeeze_has_its_reserve_at_once():
    made = hold(reserve=0.3)
    made.engage(THETA, STILL, PRESSED)
    torque = made.step(THETA, STILL, terms(THETA, STILL), PRESSED)
    assert_allclose(torque, 1.3 * PRESSED, atol=1e-12)


def squeeze_under(made, load: float, ticks: int = 50) -> float:
    """Return how many times the first squeeze the hold answers to a load on each tip [N]."""
    made.engage(THETA, STILL, PRESSED)
    pressed = PRESSED + joint_torque(TIPS, np.tile([0.0, 0.0, load], (3, 1)))
    for _ in range(ticks):
        torque = made.step(THETA, STILL, terms(THETA, STILL), pressed)
    return float(torque @ PRESSED / (PRESSED @ PRESSED))


def test_the_squeeze_grows_with_the_load_and_never_falls():
    total = np.linalg.norm(SQUEEZE, axis=1).sum()
    made = hold(reserve=0.0, friction=0.5)
    assert squeeze_under(made, -1.0) == pytest.approx(1.0 + 3.0 / (0.5 * total), rel=1e-3)
    torque = made.step(THETA, STILL, terms(THETA, STILL), PRESSED)
    assert torque @ PRESSED / (PRESSED @ PRESSED) > 1.0 + 2.7 / (0.5 * total)


def test_the_squeeze_ends_at_its_limit_and_at_the_joints():
    total = np.linalg.norm(SQUEEZE, axis=1).sum()
    limited = hold(squeeze_limit=1.5 * total)
    assert squeeze_under(limited, -50.0) == pytest.approx(1.5, rel=1e-6)
    above = hold(squeeze_limit=0.5 * total)
    assert squeeze_under(above, -50.0) == pytest.approx(1.0)
    joints = squeeze_under(hold(squeeze_limit=1e4), -500.0)
    assert joints * np.abs(PRESSED).max() == pytest.approx(HAND.effort_limits.max(), rel=1e-6)


def test_fingers_that_do_not_press_are_not_made_to():
    made = hold()
    made.engage(THETA, STILL, STILL)
    load = joint_torque(TIPS, np.tile([0.0, 0.0, -5.0], (3, 1)))
    assert_allclose(made.step(THETA, STILL, terms(THETA, STILL), load), 0.0, atol=1e-12)
