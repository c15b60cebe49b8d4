# SPDX-License-Identifier: Apache-2.0
"""The guard passes valid commands unchanged, and replaces all others by a hold."""

import numpy as np
import pytest

from tactile_hand_ros.control import command_guard
from tactile_hand_ros.control.command_guard import CommandGuard, GuardConfig, TorqueCommand
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.holds import GraspTorque, joint_torque, spring
from tactile_hand_ros.control.stability import buckling_rate
from tactile_hand_ros.hand.hand import Hand

TICK = 2_000_000
HAND = Hand.load("paper", gravity=np.array([0.0, 0.0, -9.81]))
THETA = np.tile([1.047, 0.0, 1.571], 3)
STILL = np.zeros(9)
TORQUE = HAND.gravity_torque(THETA) + np.linspace(-0.2, 0.2, 9)


def guard(**changes) -> CommandGuard:
    return CommandGuard(GuardConfig().changed(changes), HAND, TICK)


def step(made, tick, command=None, *, answers=None, theta=THETA, rates=STILL, refused=""):
    """Step at a tick with a torque that answers it or an earlier one."""
    if command is not None:
        command = TorqueCommand((tick if answers is None else answers) * TICK, np.asarray(command))
    return made.step(tick * TICK, theta, rates, command, refused)


def follow(made, torque=TORQUE):
    for tick in range(6):
        step(made, tick, torque)
    return 6


def followed(theta):
    """Return `TORQUE` at another posture, whose internal forces turn with the fingers."""
    pressed = GraspTorque.of(HAND.fingertips(THETA), TORQUE - HAND.gravity_torque(THETA))
    return pressed.at(HAND.fingertips(theta), 1.0) + HAND.gravity_torque(theta)


def test_good_commands_pass_to_the_bit():
    made = guard()
    for tick in range(200):  # the same torque, at rest
        np.testing.assert_array_equal(step(made, tick, TORQUE), TORQUE)
    assert not made.reason and not made.holding and made.held == 0 and not made.holds


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (TORQUE[:8], command_guard.WRONG_SHAPE),
        (np.where(np.arange(9) == 4, np.nan, TORQUE), command_guard.NOT_FINITE),
        (np.full(9, np.inf), command_guard.NOT_FINITE),
    ],
)
def test_a_wrong_command_starts_a_hold_and_is_named(command, reason):
    made = guard()
    answer = step(made, follow(made), command)
    assert made.reason == reason and made.held == 1 and np.isfinite(answer).all()


def test_bad_commands_while_taking_over_hold_on_without_another_reserve():
    made = guard()
    tick = follow(made) + 9
    held = step(made, tick, TORQUE, answers=0)
    step(made, tick + 1, TORQUE)
    again = step(made, tick + 2, TORQUE, answers=0)
    np.testing.assert_allclose(again, held, atol=1e-9)
    assert made.holds == {command_guard.LATE: 2}


def test_where_no_time_has_passed_nothing_presses():
    made, pressing = guard(**{"hold.reserve": 0.0}), TORQUE + 1.0
    made.step(5 * TICK, THETA, STILL, TorqueCommand(5 * TICK, pressing))
    held = made.step(5 * TICK, THETA, STILL, None)
    np.testing.assert_allclose(held, HAND.gravity_torque(THETA), atol=1e-12)


def test_a_clock_that_steps_back_keeps_the_grasp():
    made = guard(**{"hold.reserve": 0.0})
    for tick in range(100, 106):
        step(made, tick, TORQUE)
    np.testing.assert_allclose(step(made, 50, TORQUE, answers=105), TORQUE, atol=1e-9)


def test_commands_take_over_in_equal_steps():
    made, other = guard(blend_time=0.008), TORQUE + np.linspace(1.0, 2.0, 9)
    tick = follow(made) + 9
    held = step(made, tick, TORQUE, answers=0)
    for more in range(1, 4):
        expected = held + 0.25 * more * (other - held)
        np.testing.assert_allclose(step(made, tick + more, other), expected, rtol=1e-9)
        assert made.holding and not made.reason
    np.testing.assert_array_equal(step(made, tick + 4, other), other)
    assert not made.holding


def test_a_joint_is_too_fast_above_its_limit_and_slow_again_at_four_fifths_of_it():
    made, joint, limits = guard(speed_limit=1.0), np.eye(9)[3], HAND.velocity_limits
    above, fast = np.nextafter(1.0, 2.0), command_guard.TOO_FAST
    speeds = ((1.0, ""), (above, fast), (np.nextafter(0.8, 1.0), fast), (0.8, ""))
    for tick, (speed, reason) in enumerate(speeds):
        step(made, tick, TORQUE, rates=-speed * joint)
        assert made.reason == reason
    made = guard()
    for tick, (rates, reason) in enumerate(((limits, ""), (np.nextafter(limits, np.inf), fast))):
        step(made, tick, TORQUE, rates=rates)
        assert made.reason == reason


def test_torques_of_commands_and_holds_stay_inside_the_limits_of_the_joints():
    made = guard()
    np.testing.assert_array_equal(step(made, 0, np.full(9, 1e308)), np.full(9, 20.0))
    assert not made.reason
    made = guard(**{"hold.reserve": 0.0, "hold.internal_force_limit": 0.0})
    last = follow(made)
    step(made, last)
    far = step(made, last + 1, theta=THETA + 1.0)
    assert np.abs(far).max() == 20.0 and (far == -20.0).sum() > 2


def test_a_change_is_limited_from_the_torque_before_and_not_after_a_hold():
    made = guard(torque_rate=50.0, blend_time=0.002)
    last = follow(made)
    down = TORQUE - np.linspace(0.0, 0.5, 9)
    expected = TORQUE - np.minimum(np.linspace(0.0, 0.5, 9), 0.1)
    np.testing.assert_allclose(step(made, last, down), expected, atol=1e-12)
    step(made, last + 1)
    np.testing.assert_array_equal(step(made, last + 2, TORQUE - 3.0), TORQUE - 3.0)


def test_holds_are_counted_by_reason_when_they_start_and_ticks_always():
    made = guard(patience=0.0)
    tick = follow(made)
    for more in range(3):
        step(made, tick + more, TORQUE, refused="another sender")
    assert made.holds == {"another sender": 1} and made.held == 3
    step(made, tick + 3)
    assert made.holds == {"another sender": 1, command_guard.NO_COMMAND: 1} and made.held == 4
    assert made.reason == command_guard.NO_COMMAND


def test_a_reset_forgets_the_past_the_torque_before_and_a_torque_that_stood_still():
    weight, made = HAND.gravity_torque(THETA), guard(torque_rate=50.0)
    tick = follow(made) + 10
    made.reset()
    turned = weight - (TORQUE - weight)  # neither rate-limited nor pulling off
    np.testing.assert_array_equal(step(made, tick, turned), turned)
    assert not made.reason
    made.reset()
    np.testing.assert_array_equal(step(made, tick + 1, turned, theta=THETA + 0.01), turned)
    assert not made.reason and made.age == 0


def test_a_reset_forgets_earlier_holds_and_their_patience():
    made = guard(patience=0.1)
    tick = follow(made)
    for _ in range(3):
        held_after(made, tick, 60)
        tick += 61
    made.reset()
    assert not made.holds and not made.reason and not made.holding
    assert made.held == 0 and made.age == -1
    step(made, tick, TORQUE)
    assert held_after(made, tick + 1, 20) == 0


def test_before_the_first_command_gravity_is_carried_and_that_acts_at_once():
    made = guard()
    np.testing.assert_allclose(step(made, 0), HAND.gravity_torque(THETA), atol=1e-12)
    step(made, 1, TORQUE)
    assert not made.reason and made.holding


def test_a_command_that_comes_again_is_judged_by_its_age_alone_unless_it_was_stuck():
    made = guard()
    last, moved = follow(made) - 1, THETA + 0.01
    for late in (1, 2, 3):
        again = step(made, last + late, TORQUE, answers=last, theta=moved)
        np.testing.assert_array_equal(again, TORQUE)
        assert not made.reason
    made = guard()
    last = follow(made)
    step(made, last, TORQUE, theta=moved)
    assert made.reason == command_guard.STUCK
    step(made, last + 1, TORQUE, answers=last, theta=moved)
    assert made.reason == command_guard.STUCK and made.holds == {command_guard.STUCK: 1}


@pytest.mark.parametrize(
    ("turned", "resolution", "stuck"),
    [(0.00199, 0.0, False), (0.00201, 0.0, True), (0.0039, 0.001, False), (0.0041, 0.001, True)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_may_move_two_milliradians_or_four_errors_of_its_encoder_under_the_same_torque(
    turned, resolution, stuck, sign
):
    made = guard(**{"hold.resolution": resolution})
    moved, tick = THETA + sign * turned * (np.arange(9) == 7), follow(made)
    step(made, tick, TORQUE, theta=moved)
    assert (made.reason == command_guard.STUCK) == stuck
    step(made, tick + 1, TORQUE + 1e-9, theta=moved)
    assert not made.reason


@pytest.mark.parametrize(("pull", "reason"), [(-0.19, ""), (-0.21, command_guard.PULLS)])
def test_a_command_may_pull_with_a_fifth_of_the_grasp_force(pull, reason):
    """On top of weight and bias, which are no grasp force, and of a common load on all tips."""
    weight, load = HAND.gravity_torque(THETA), np.tile([0.3, -2.0, 1.0], (3, 1))
    carry = joint_torque(HAND.fingertips(THETA), load)
    made = guard()
    step(made, follow(made, TORQUE + carry), weight + carry + pull * (TORQUE - weight))
    assert made.reason == reason


def test_to_let_go_step_by_step_is_no_jump():
    """Each step is below 0.02 N m; the last ones pull."""
    weight, made = HAND.gravity_torque(THETA), guard()
    for tick, share in enumerate(np.arange(1.0, -1.0, -0.09), follow(made)):
        step(made, tick, weight + share * (TORQUE - weight))
        assert not made.reason


def test_fingers_that_hardly_press_may_be_pulled_anywhere():
    """Below a hundredth of a finger's weight, a jump can reverse the contact forces."""
    for fraction, reason in ((0.9, ""), (20.0, command_guard.PULLS)):
        weight, made = HAND.gravity_torque(THETA), guard()
        tips = HAND.fingertips(THETA)
        presses = GraspTorque.of(tips, TORQUE - weight).internal_forces(tips)
        share = fraction * HAND.minimum_force / np.linalg.norm(presses, axis=1).sum()
        tick = follow(made, weight + share * (TORQUE - weight))
        step(made, tick, weight - share * 2.0 * (TORQUE - weight))
        assert made.reason == reason


def test_a_hold_that_goes_on_brakes_where_the_commands_have_brought_the_joints():
    made, there = guard(**{"hold.reserve": 0.0, "hold.internal_force_limit": 0.0}), THETA + 0.01
    tick = follow(made)
    step(made, tick, refused="a second sender")
    step(made, tick + 1, TORQUE + 1e-6, theta=there)
    assert made.holding and not made.reason
    again = step(made, tick + 2, theta=there, refused="a second sender")
    np.testing.assert_allclose(again, followed(there), atol=1e-9)  # a spring would add newtons


def test_while_commands_take_over_their_drive_is_no_load():
    made = guard(blend_time=0.02, **{"hold.reserve": 0.0})
    tick = follow(made)
    step(made, tick, refused="a second sender")
    carry = joint_torque(HAND.fingertips(THETA), np.tile([0.0, 0.0, -3.0], (3, 1)))
    for more in range(1, 5):
        torque = step(made, tick + more, TORQUE + carry)
        np.testing.assert_allclose(torque, TORQUE + 0.1 * more * carry, atol=1e-9)


def test_the_posture_of_the_first_held_tick_is_kept():
    made = guard(**{"hold.reserve": 0.0, "hold.internal_force_limit": 0.0})
    last = follow(made) - 1
    step(made, last + 4, TORQUE, answers=last)
    pushed = THETA + 0.001
    for late in range(5, 9):
        answer = step(made, last + late, TORQUE, answers=last, theta=pushed)
    inertia = HAND.dynamics(pushed, STILL)[1]
    back = spring(inertia, 250.0, THETA - pushed, STILL)
    np.testing.assert_allclose(answer, followed(pushed) + back, atol=1e-9)


@pytest.mark.parametrize(
    "bad", [np.full(9, np.nan), np.full(9, np.inf), np.where(np.arange(9) == 4, np.nan, THETA)]
)
@pytest.mark.parametrize("what", ["theta", "rates"])
def test_joint_states_that_are_not_finite_start_a_hold_without_the_drive(bad, what):
    """The last torque drove the joints; repeating it would continue the motion."""
    made, tick = guard(**{"hold.reserve": 0.0}), 8
    np.testing.assert_array_equal(step(made, 0, TORQUE, **{what: bad}), np.zeros(9))
    assert made.reason == command_guard.BLIND and made.held == 1
    made.reset()
    drive = 0.1 * HAND.dynamics(THETA, STILL)[1] @ np.ones(9) / 0.002
    for each in range(tick):
        step(made, each, TORQUE + drive, rates=0.1 * each * np.ones(9))
    held = [step(made, tick + more, TORQUE + drive, **{what: bad}) for more in range(100)]
    assert made.reason == command_guard.BLIND and made.holds == {command_guard.BLIND: 1}
    np.testing.assert_allclose(held[-1], TORQUE, atol=0.2)  # the posture moved slightly
    assert np.abs(drive).max() > 0.5


def held_after(made, tick, good):
    """Send a late command, then valid ones; return during how many of these the joints are held."""
    step(made, tick, TORQUE, answers=tick - 4)
    held = 0
    for more in range(1, good + 1):
        step(made, tick + more, TORQUE)
        held += bool(made.reason)
    return held


def test_where_holds_follow_each_other_commands_must_be_good_for_a_while():
    """On an overloaded computer, the hand rests instead of switching back and forth."""
    made = guard(patience=0.1)
    tick = follow(made)
    for expected, good in ((0, 60), (50, 60), (20, 20), (50, 60), (50, 250), (0, 20)):
        assert held_after(made, tick, good) == expected  # ticks of 2 ms
        tick += good + 1
    assert made.holds == {command_guard.LATE: 5}  # one continued


@pytest.mark.parametrize(
    ("late", "age", "reason", "limit"),
    [
        (-TICK, -1, command_guard.AHEAD, 3),
        (1 - TICK, 0, "", 0),
        (TICK - 1, 0, "", 0),
        (TICK, 1, command_guard.LATE, 0),
        (4 * TICK - 1, 3, "", 3),
        (4 * TICK, 4, command_guard.LATE, 3),
    ],
)
def test_a_command_may_be_as_old_as_the_configuration_says_in_full_ticks(late, age, reason, limit):
    made = guard(age_limit=limit)
    stamp = follow(made) * TICK
    made.step(stamp, THETA, STILL, TorqueCommand(stamp - late, TORQUE + 1e-6))
    assert (made.age, made.reason) == (age, reason)


@pytest.mark.parametrize("force", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("finger", [[1.309, 0.0, 1.1697], [1.2, 0.1, 1.3]])
def test_commands_may_be_as_late_on_average_as_the_grasp_bears(force, finger):
    """By 0.85 of sqrt(2) / p, with the rate p at which light fingers buckle."""
    human, tick = Hand.load("human"), 4_000_000
    theta = np.tile(finger, 3)
    tips = human.fingertips(theta)
    inwards = tips.positions.mean(axis=0) - tips.positions
    lengths = np.linalg.norm(inwards, axis=1, keepdims=True)
    forces = force * inwards / lengths.sum()
    points = tips.positions + human.radii[:, None] * inwards / lengths
    contacts = Contacts(points, np.tile(np.eye(3), (3, 1, 1)))
    oldest = round(1e9 * 1.2 / buckling_rate(human, theta, contacts, forces))
    assert tick < oldest
    torque = joint_torque(tips, forces)
    for mean, swing, reason in ((0.97, 0.2, ""), (1.03, 0.0, command_guard.LATE)):
        made = CommandGuard(GuardConfig(age_limit=9), human, tick)
        for i in range(200):
            late = round((mean + swing * (-1.0) ** i) * oldest)
            now = 10**9 + i * tick
            made.step(now, theta, STILL, TorqueCommand(now - late, torque))
        assert made.reason == reason and made.holds[command_guard.LATE] == (not swing)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_torques_of_any_size_that_come_late_are_judged():
    made = guard()
    for tick in range(100):
        torque = 1.5e308 * np.linspace(-1.0, 1.0, 9) * (-1.0) ** tick
        assert np.isfinite(step(made, tick, torque, answers=tick - 2)).all()


def test_what_the_contacts_press_with_follows_from_the_last_ticks():
    """From the maximum delay plus two ticks, so that neither drive nor damping is kept."""
    random = np.random.default_rng(3)
    made, rates = guard(age_limit=1, **{"hold.reserve": 0.0}), 0.1 * random.standard_normal((7, 9))
    torques = TORQUE + 0.1 * random.standard_normal((6, 9))
    for tick in range(6):
        step(made, tick, torques[tick], rates=rates[tick])
    inertia = HAND.dynamics(THETA, rates[6])[1]
    weight = HAND.dynamics(THETA, rates[6])[2]
    pressed = torques[3:6].mean(axis=0) - inertia @ (rates[6] - rates[3]) / 0.006 - weight
    held = step(made, 6, rates=rates[6])  # braking starts without a torque of its own
    np.testing.assert_allclose(held, pressed + weight, rtol=1e-12)


def test_a_driver_may_use_its_buffers_again():
    made, torque, theta = guard(), TORQUE.copy(), THETA.copy()
    for tick in range(20):
        torque += 1e-3
        theta += 5e-4
        made.step(tick * TICK, theta, STILL, TorqueCommand(tick * TICK, torque))
        assert not made.reason
    theta[4] = np.nan
    assert np.isfinite(made.step(20 * TICK, theta, STILL, None)).all()
    assert made.reason == command_guard.BLIND


def test_held_ticks_are_counted_once_whatever_their_stamps():
    made = CommandGuard(GuardConfig(), HAND, TICK, TICK // 4)
    for steps in range(20):
        made.step(1_700_000_000_123_456_789 + steps * TICK // 4, THETA, STILL, None)
    assert made.held in (5, 6)
