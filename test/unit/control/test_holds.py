# SPDX-License-Identifier: Apache-2.0
"""Holds are as stiff as the tick rate allows, and stiff enough for hands of any size."""

import random

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.hands import prism_grasp
from support.plants import pressing, rates_of_twists

from studies.faults.situations import SITUATIONS, scenario
from studies.invariance import resized
from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control import command_guard
from tactile_hand_ros.control.holds import (
    GraspTorque,
    GuardHold,
    GuardHoldConfig,
    buckling_rate,
    fitted_gains,
    joint_torque,
    spring,
    stiffest,
)
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.hand.hand import Hand, tip_forces
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

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


def test_a_finger_that_is_nearly_straight_is_not_asked_for_forces_that_no_joint_makes():
    """Along a straight finger, rounding errors of the torque would appear as meganewtons."""
    straight = THETA.copy()
    straight[2] = 1e-8
    assert np.abs(tip_forces(HAND.fingertips(straight), PRESSED)).max() < 50.0


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


def buckling(folder, scale, mass, force=18.0):
    """Return the rate at which a grasp of the paper's hand in another size buckles."""
    plant = Plant(scaled(folder, scale, mass).plant)
    grasp = plant.hand, plant.state.theta, plant.state.contacts
    return buckling_rate(*grasp, force * pressing(plant))


def test_how_fast_a_grasp_buckles_follows_from_force_lever_and_inertia(tmp_path):
    """p^2 M_h = force x lever, and M_h grows with the square of the size."""
    full = buckling(tmp_path, 1.0, 0.25)
    assert full == pytest.approx(18.49, rel=1e-3)  # in the plant 18.5
    for scale, mass, force in ((0.25, 0.25, 18.0), (1.0, 0.03, 18.0), (0.25, 0.01, 5.0)):
        found = buckling(tmp_path, scale, mass, force)
        expected = full * np.sqrt(0.25 / mass * force / 18.0 / scale)
        assert found == pytest.approx(expected, rel=1e-6)


@example(scale=0.25, mass=0.01, moment=0.5)  # the lightest
@settings(max_examples=3, derandomize=True, suppress_health_check=list(HealthCheck), deadline=None)
@given(
    scale=st.sampled_from([0.25, 0.25, 1.0]),
    mass=st.floats(np.log(0.01), np.log(0.25)).map(np.exp),
    moment=st.floats(0.3, 0.6),
)
def test_hands_of_any_size_keep_the_object_while_commands_stop(tmp_path, scale, mass, moment):
    guarded = GuardedLoop(scaled(tmp_path, scale, mass))
    guarded.run(moment)
    watch = Watch(guarded)
    watch.run(1.0, answers=False)
    assert not watch.is_lost and watch.moved < 3e-3


def held_late(guarded, seconds):
    """Hold from now on with torques three ticks late, and return what was watched."""
    controller = guarded.loop.controller
    controller.step = lambda stamp, theta, rates, *_: controller.hold(
        theta, rates, "silence", stamp=stamp
    )
    watch = Watch(guarded)
    watch.run(seconds, answers=True, delay=3)
    assert guarded.loop.state.contacts.all_touching
    return watch


@pytest.mark.parametrize(("mass", "warns"), [(0.01, False), (0.004, True)])
def test_a_grasp_that_the_controller_could_not_hold_is_warned_of_and_only_that(
    tmp_path, mass, warns
):
    """At 1 kHz with torques three ticks late, 10 g per link are enough, 4 g are not."""
    guarded = GuardedLoop(scaled(tmp_path, 0.25, mass))
    guarded.run(0.5)
    warning = guarded.loop.controller.warning
    assert bool(warning) == warns
    if warns:
        assert "would buckle: at 1000 Hz the hold has a bandwidth of 125 rad/s" in warning
    else:
        assert held_late(guarded, 1.0).moved < 3e-3


@pytest.mark.parametrize(("situation", "farthest"), [("heavy", 5e-3), ("moving", 4e-3)])
def test_holds_what_is_heavy_and_what_moves_also_with_torques_three_ticks_late(situation, farthest):
    """At 250 Hz; a spring that is too soft gives way to the load."""
    guarded = GuardedLoop(scenario(situation, "processes"))
    guarded.run(SITUATIONS[situation].time + 0.1)
    assert held_late(guarded, 2.0).moved < farthest


@pytest.mark.parametrize("late", ["2", "3", "012"])
def test_light_fingers_are_held_where_late_commands_cannot_drive_them(late):
    """A pull of 4 N at 250 Hz: torques two ticks late would shake the object out of the hand."""
    guarded, chance = GuardedLoop(scenario("human, pulled", "processes")), random.Random(3)
    guarded.run(0.3)
    watch = Watch(guarded)
    for _ in range(500):
        watch.run(1.0 / guarded.rate, delay=int(chance.choice(late)))
    assert guarded.guard.holds[command_guard.LATE] and not watch.is_lost
    assert watch.slid < 1e-4


def test_a_hold_that_begins_with_the_grasp_keeps_a_load_that_comes_on():
    """Forces of constant direction would turn an object that has turned out of the fingers."""
    guarded = GuardedLoop(scenario("human, pulled", "processes"))
    guarded.run(0.02)
    watch = Watch(guarded)
    watch.run(1.5, answers=False)
    assert not watch.is_lost and watch.slid < 1e-4 and watch.moved < 0.01


@pytest.mark.parametrize("tick", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize("name", ["pull", "human_hold"])
def test_gains_that_fit_a_hand_leave_each_motion_its_damping(tick, name):
    plant = Plant(load_scenario(name).plant)
    grasp = plant.hand, plant.state.theta, plant.state.contacts
    damping, stiffness = fitted_gains(*grasp, pressing(plant), tick, 0.01, 0.02).at(3.0, 2.0)
    speed = np.linalg.eigvals(np.linalg.solve(plant.hand.dynamics(grasp[1], STILL)[1], damping))
    assert_allclose(speed, 1.0 / tick)
    # A pose that is late, and an object of 1.5 times a load of 2 N, cost 0.25 rad.
    late = 0.01 + max(0.02, 3.0 * tick)
    rates, arms = rates_of_twists(plant), grasp[2].positions - grasp[2].centroid
    of_motion = np.linalg.inv(rates.T @ damping @ rates)
    body = 1.5 * 2.0 / 9.81 * np.diag(np.repeat([1.0, (arms**2).sum() / 3.0], 3))
    inverse = 4.0 * (late * of_motion + of_motion @ body @ of_motion)
    turns = np.repeat([1.0, 2.0], 3)  # r_d for an angle
    assert_allclose(stiffness * turns @ inverse, np.eye(6), atol=1e-6)


@pytest.mark.parametrize("bits", [14, 16])
def test_an_object_above_its_contacts_does_not_topple(bits):
    """300 g, with the center of mass 20 mm higher, in light fingers."""
    box = {"size": [0.04, 0.04, 0.09], "mass": 0.3, "position": [0.0, 0.0, 0.0819]}
    changes = {f"plant.object.{name}": value for name, value in box.items()}
    changes |= {"plant.encoder.bits": bits, "duration": 2.5}
    record = ClosedLoop(load_scenario("human_hold", changes)).run()
    late = record.object_quaternion[1000:]
    assert np.abs(late @ late[0]).min() > np.cos(0.5 * 0.1)  # half of an angle of 0.1 rad


@pytest.mark.parametrize(
    ("rate", "delay", "allowed", "is_kept"),
    [(1000, 0, 3, True), (1000, 3, 3, True), (500, 2, 3, True), (1000, 3, 0, False)],
)
def test_the_law_allows_for_late_torques(rate, delay, allowed, is_kept):
    """The light fingers of the human hand under a sudden pull, which late torques would lose."""
    pull = {"kind": "ramp", "start": 0.1, "duration": 0.2, "force": [0.0, 0.0, -4.0]}
    changes = {"plant.rate": rate, "plant.disturbances": [pull]}
    changes["manipulation_controller.hold.latency"] = allowed
    watch = Watch(GuardedLoop(load_scenario("human_pull", changes)))
    watch.run(1.0, delay=delay)
    assert not (is_kept and watch.is_lost)
    assert (watch.slid < 1e-3) is is_kept


@pytest.mark.parametrize(("rate", "delay"), [(1000, 2), (500, 1)])
def test_a_heavy_object_and_a_delay_of_two_milliseconds_need_no_more_force(rate, delay):
    """Noise of the skin does not make the fingers swing, which the regulator would answer."""
    skin = {"tactile_sensor.rate": rate, "tactile_sensor.bandwidth": 0.4 * rate}
    loop = GuardedLoop(load_scenario("human_lift", skin | {"plant.rate": rate}))
    Watch(loop).run(3.5, delay=delay)
    assert loop.loop.regulator.grasp_force < 12.0
    assert loop.loop.state.slid.max() < 1e-4


@pytest.mark.parametrize(
    ("bits", "gains", "latency", "seed"),
    [
        (12, "given", 0.005, 5),
        (12, "fitted", 0.0, 5),
        (14, "fitted", 0.0, 5),
        (20, "fitted", 0.0, 2),
    ],
)
def test_steps_of_the_encoders_in_the_torques_are_no_slip(bits, gains, latency, seed):
    """A sudden pull moves the joints, and so the steps of their angles into the torques."""
    changes = {"plant.encoder.bits": bits, "seed": seed, "duration": 3.0}
    changes |= {"tactile_sensor.latency": latency}
    if gains == "fitted":
        changes |= {"manipulation_controller.law.damping": 0.0}
    loop = ClosedLoop(load_scenario("pull", changes))
    assert not (loop.run().grip == ContactState.SLIP).any()


@pytest.mark.parametrize("joints", [[3, 3, 3], [4, 4, 4, 4], [3, 4, 3, 5, 4]])
def test_with_encoders_only_what_moves_the_object_is_damped_as_k_f_needs_it(tmp_path, joints):
    plant = Plant(load_scenario("gravity", prism_grasp(tmp_path, joints)).plant)
    hand, theta, contacts = plant.hand, plant.state.theta, plant.state.contacts
    how = pressing(plant), 1e-3, 0.01, 0.02, 1e-3
    gains = fitted_gains(hand, theta, contacts, *how)
    inertia = hand.dynamics(theta, np.zeros(hand.joints))[1]
    allowed = 0.03 * hand.finger_weight * hand.spans.max()
    quietest = np.sqrt(allowed / (1e-3 * np.linalg.eigvalsh(inertia)))

    def bandwidths(grasp_force):
        return np.linalg.eigvals(np.linalg.solve(inertia, gains.at(grasp_force, 0.0)[0])).real

    quiet = np.sort(bandwidths(0.0))  # each axis shakes the hand alike: light joints bear more
    assert quiet[0] > 0.999 * quietest.min() and 0.5 < quiet[-1] / quietest.max() < 1.001
    assert np.sort(bandwidths(1e9))[-6:] == pytest.approx(1000.0, rel=1e-6)
    most = 0.5 * (quietest.max() + 1000.0)
    found = np.sort(bandwidths(most / gains.needed))
    assert found[-7] < 1.001 * quietest.max()
    assert_allclose(found[-6:], most, rtol=1e-6)
    # Torques that are two ticks late allow half as much.
    gains = fitted_gains(hand, theta, contacts, *how, 2)
    assert np.sort(bandwidths(1e9))[-6:] == pytest.approx(500.0, rel=1e-6)
