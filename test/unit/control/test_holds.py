# SPDX-License-Identifier: Apache-2.0
"""Holds are as stiff as the tick rate allows, and stiff enough for hands of any size."""

import random

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from support.outcomes import watched

from studies.faults.situations import SITUATIONS, scenario
from studies.invariance import resized
from tactile_hand_ros.control import command_guard
from tactile_hand_ros.control.holds import (
    GraspTorque,
    GuardHold,
    GuardHoldConfig,
    joint_torque,
    spring,
    stiffest,
)
from tactile_hand_ros.hand.hand import Hand, tip_forces
from tactile_hand_ros.rotations import rotation_from_vector

HAND = Hand.load("paper")
THETA = np.tile([1.047, 0.0, 1.571], 3)
STILL = np.zeros(9)
SPEED = np.linspace(-0.5, 0.5, 9)
W = 250.0  # rad/s at ticks of 2 ms: 0.5 / T
TIPS = HAND.fingertips(THETA)
# Towards the center of the tips: balanced forces that only press the tips together.
INTERNAL = 8.0 * (TIPS.positions.mean(axis=0) - TIPS.positions)
TOTAL = np.linalg.norm(INTERNAL, axis=1).sum()
PRESSED = joint_torque(TIPS, INTERNAL)
terms = HAND.dynamics


def hold(tick=0.002, **changes) -> GuardHold:
    return GuardHold(GuardHoldConfig().changed(changes), HAND, tick)


@pytest.mark.parametrize("tick", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize(("lag", "resolution"), [(0.0, 0.0), (0.5, 1e-6)])
def test_a_moving_free_hand_comes_to_rest_and_stays(tick, lag, resolution):
    """Stable at every rate, even with rates that are half a tick late."""
    made, theta, rates = hold(tick, resolution=resolution), THETA, SPEED
    made.engage(theta, rates, STILL)
    seen = rates
    for _ in range(round(1.0 / tick)):
        model = terms(theta, rates)
        torque = made.step((theta, lag * seen + (1.0 - lag) * rates), model, follows=False)
        seen = rates
        theta = theta + 0.5 * tick * rates
        rates = rates + tick * np.linalg.solve(model.inertia, torque - model.bias)
        theta = theta + 0.5 * tick * rates
    assert_allclose(rates, 0.0, atol=1e-4)
    assert np.abs(theta - THETA).max() < 0.012


def test_a_hold_is_as_stiff_as_its_delay_allows_and_encoders_shake_it_little():
    inertia, delay = np.diag(np.linspace(0.02, 0.08, 9)), (0.001, 0.001)
    assert stiffest(HAND, inertia, *delay, 0.0) == 500.0
    assert stiffest(HAND, inertia, *delay, 1e-9) == pytest.approx(1000.0 / 3.0)
    shaken = stiffest(HAND, inertia, *delay, 1e-3)
    assert shaken**2 * 0.08 * 1e-3 == pytest.approx(0.03 * HAND.finger_weight * HAND.spans.max())


def test_braking_starts_without_a_step_of_the_torque_and_stops_in_a_spring():
    made, model = hold(reserve=0.0), terms(THETA, SPEED)
    made.engage(THETA, SPEED, PRESSED)
    first = made.step((THETA, SPEED), model, follows=False)
    assert_allclose(first, PRESSED + model.bias, atol=1e-12)
    for _ in range(100):
        made.step((THETA, STILL), terms(THETA, STILL), follows=False)
    posture, speed = made.reference
    assert_allclose(posture, THETA + 2.0 * 0.006 * SPEED, atol=1e-9)
    assert_allclose(speed, 0.0, atol=1e-9)
    model, off = terms(posture, STILL), np.linspace(0.0, 0.01, 9)
    found = made.step((posture - off, STILL), model, follows=False)
    pressed = GraspTorque.of(TIPS, PRESSED).at(model.tips, 1.0)
    assert_allclose(found, pressed + spring(model.inertia, W, off, STILL), atol=1e-9)


@pytest.mark.parametrize("pressed", [PRESSED, 0.0 * PRESSED])
def test_a_hold_that_begins_again_elsewhere_still_carries_the_load(pressed):
    made, model, sag = hold(), terms(THETA, STILL), np.linspace(-0.01, 0.01, 9)
    made.engage(THETA, STILL, pressed)
    for _ in range(200):
        before = made.step((THETA + sag, STILL), model, follows=True)
    for _ in range(50):  # blind ticks
        assert_allclose(made.step(None, model, follows=True), before, atol=1e-9)
    made.brake(THETA + 0.02, STILL)
    after = made.step((THETA + 0.02, STILL), model, follows=True)
    assert_allclose(after, before, atol=1e-9)
    assert_allclose(made.reference[0], THETA + 0.02 - sag, atol=1e-9)


def factor_under(made, load: float, ticks: int = 200) -> float:
    """Return the hold's internal force under a load on each tip [N], relative to the first one.

    The load has deflected the spring, whose torque is subtracted.
    """
    made.engage(THETA, STILL, PRESSED)
    model = terms(THETA, STILL)
    torque = joint_torque(TIPS, np.tile([0.0, 0.0, load], (3, 1)))
    away = np.linalg.solve(W * W * model.inertia, torque)
    for _ in range(ticks):
        answer = made.step((THETA - away, STILL), model, follows=True)
    internal = answer - spring(model.inertia, W, away, STILL)
    return float(internal @ PRESSED / (PRESSED @ PRESSED))


def test_the_internal_force_grows_with_the_load_and_never_falls():
    made = hold(reserve=0.0, friction=0.5)
    grown = 1.0 + 3.0 / (0.5 * TOTAL)
    assert factor_under(made, -1.0) == pytest.approx(grown, rel=1e-6)
    for _ in range(100):
        torque = made.step((THETA, STILL), terms(THETA, STILL), follows=True)
    assert_allclose(torque, grown * PRESSED, rtol=1e-6, atol=1e-12)


def test_the_internal_force_ends_at_its_limit_and_at_the_joints():
    for limit, factor in ((1.5, 1.5), (0.5, 1.0)):
        made = hold(internal_force_limit=limit * TOTAL)
        assert factor_under(made, -5.0) == pytest.approx(factor, rel=1e-6)
    joints = factor_under(hold(internal_force_limit=1e4, friction=0.01), -5.0)
    assert joints * np.abs(PRESSED).max() == pytest.approx(HAND.effort_limits.max(), rel=1e-6)


def test_internal_forces_turn_with_the_fingers_and_the_load_does_not():
    pressed = PRESSED + joint_torque(TIPS, np.array([[0.3, 0.1, -1.0]] * 3))
    grasp = GraspTorque.of(TIPS, pressed)
    assert_allclose(grasp.internal_forces(TIPS), INTERNAL, atol=1e-9)
    assert_allclose(grasp.at(TIPS, 1.0), pressed, atol=1e-12)
    assert_allclose(grasp.at(TIPS, 3.0), pressed + 2.0 * PRESSED, atol=1e-9)
    turn = rotation_from_vector([0.2, -0.1, 0.3])
    turned = TIPS._replace(positions=TIPS.positions @ turn.T, linear=turn @ TIPS.linear)
    assert_allclose(grasp.internal_forces(turned), INTERNAL @ turn.T, atol=1e-9)
    assert_allclose(grasp.at(turned, 2.0) - grasp.at(TIPS, 2.0), 0.0, atol=1e-9)


def test_what_an_encoder_cannot_tell_is_no_load():
    """Angles that jump between two 14-bit steps do not change the internal force."""
    step, random = 2.0 * np.pi / 2**14, np.random.default_rng(1)
    made = hold(reserve=0.0, resolution=step)
    made.engage(THETA, STILL, PRESSED)
    model = terms(THETA, STILL)
    for _ in range(2000):
        theta = THETA + step * random.integers(-1, 2, 9)
        torque = made.step((theta, STILL), model, follows=True)
    found = torque - spring(model.inertia, made.bandwidth, THETA - theta, STILL)
    assert_allclose(found, PRESSED, atol=1e-9)


@pytest.mark.parametrize(("fraction", "factor"), [(0.9, 1.0), (1.1, 1.5)])
def test_a_hundredth_of_a_fingers_weight_is_the_minimum_internal_force(fraction, factor):
    """Above it rises by its reserve, and stays so as the hand brakes at another posture."""
    pressed, made = fraction * HAND.minimum_force / TOTAL * PRESSED, hold(reserve=0.5)
    made.engage(THETA, STILL, pressed)
    found = made.step((THETA, STILL), terms(THETA, STILL), follows=True)
    assert_allclose(found, factor * pressed, atol=1e-12)
    other = THETA + 0.02
    made.brake(other, STILL)
    found = made.step((other, STILL), terms(other, STILL), follows=False)
    at_other = GraspTorque.of(TIPS, pressed).at(HAND.fingertips(other), factor)
    assert_allclose(found, at_other, atol=1e-9)


@given(st.floats(-0.3, 0.3), arrays(float, 9, elements=st.floats(-0.1, 0.1)))
@example(1e-8, np.full(9, 1e-9))
def test_errors_of_torques_become_forces_as_at_a_tenth_of_the_longest_lever(bend, errors):
    """Along a finger that is almost straight, they would appear as large forces of the grasp."""
    tips = HAND.fingertips(np.where(np.arange(9) == 2, bend, THETA))
    longest = np.linalg.norm(tips.linear.reshape(9, 9), 2)
    wrong = tip_forces(tips, PRESSED + errors) - tip_forces(tips, PRESSED)
    assert np.linalg.norm(wrong) <= (1.0 + 1e-6) * np.linalg.norm(errors) / (0.1 * longest) + 1e-9


@given(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308))
def test_whatever_is_read_the_spring_is_finite(away, rate):
    inertia = terms(THETA, STILL).inertia
    found = spring(inertia, 100.0, np.full(9, away), np.full(9, rate))
    assert np.isfinite(found).all()
    if abs(away) < 3.0 and abs(rate) < 900.0:
        assert_allclose(found, inertia.sum(axis=1) * (1e4 * away + 200.0 * rate), atol=1e-9)


def scaled(folder, scale, mass):
    """Return `gravity` in another size, with a link mass in kg and a k_f of 20 N."""
    return resized("gravity", scale, mass, 0.1, folder, {"slip_regulator.grasp_force": 20.0})


@example(scale=0.25, mass=0.01, moment=0.5)  # the lightest
@settings(max_examples=3, derandomize=True, suppress_health_check=list(HealthCheck), deadline=None)
@given(
    scale=st.sampled_from([0.25, 0.25, 1.0]),
    mass=st.floats(np.log(0.01), np.log(0.25)).map(np.exp),
    moment=st.floats(0.3, 0.6),
)
def test_hands_of_any_size_keep_the_object_while_commands_stop(tmp_path, scale, mass, moment):
    _, watch = watched(scaled(tmp_path, scale, mass), moment)
    watch.run(1.0, answers=False)
    assert not watch.is_lost and watch.moved < 3e-3


def held_late(guarded, watch, seconds):
    """Hold from now on with torques three ticks late, and return what was watched."""
    controller = guarded.loop.controller
    controller.step = lambda stamp, joints, *_: controller.hold(
        joints._replace(applied=None), "silence", stamp=stamp
    )
    watch.run(seconds, answers=True, delay=3)
    assert guarded.loop.state.contacts.all_touching
    return watch


@pytest.mark.parametrize(("mass", "warns"), [(0.01, False), (0.004, True)])
def test_a_grasp_that_the_controller_could_not_hold_is_warned_of_and_only_that(
    tmp_path, mass, warns
):
    """At 1 kHz with torques three ticks late, 10 g per link are enough, 4 g are not."""
    guarded, watch = watched(scaled(tmp_path, 0.25, mass), 0.5)
    warning = guarded.loop.controller.warning
    assert bool(warning) == warns
    if warns:
        assert "would buckle: at 1000 Hz the hold has a bandwidth of 125 rad/s" in warning
    else:
        assert held_late(guarded, watch, 1.0).moved < 3e-3


@pytest.mark.parametrize(("situation", "farthest"), [("heavy", 5e-3), ("moving", 4e-3)])
def test_holds_what_is_heavy_and_what_moves_also_with_torques_three_ticks_late(situation, farthest):
    """At 250 Hz; a spring that is too soft gives way to the load."""
    late = watched(scenario(situation, "processes"), SITUATIONS[situation].time + 0.1)
    assert held_late(*late, 2.0).moved < farthest


@pytest.mark.parametrize("late", ["2", "3", "012"])
def test_light_fingers_are_held_where_late_commands_cannot_drive_them(late):
    """A pull of 4 N at 250 Hz: torques two ticks late would shake the object out of the hand."""
    guarded, watch = watched(scenario("human, pulled", "processes"), 0.3)
    chance = random.Random(3)
    for _ in range(500):
        watch.run(1.0 / guarded.rate, delay=int(chance.choice(late)))
    assert guarded.guard.holds[command_guard.LATE] and not watch.is_lost
    assert watch.slid < 1e-4


def test_a_hold_that_begins_with_the_grasp_keeps_a_load_that_comes_on():
    """Forces of constant direction would turn an object that has turned out of the fingers."""
    _, watch = watched(scenario("human, pulled", "processes"), 0.02)
    watch.run(1.5, answers=False)
    assert not watch.is_lost and watch.slid < 1e-4 and watch.moved < 0.01
