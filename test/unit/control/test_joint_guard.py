# SPDX-License-Identifier: Apache-2.0
"""The guard lets good commands through unchanged, and answers all others with a hold."""

import numpy as np
import pytest

from tactile_hand_ros.control import joint_guard
from tactile_hand_ros.control.joint_guard import GuardConfig, JointGuard, TorqueCommand
from tactile_hand_ros.hand.hand import Hand

TICK = 2_000_000
HAND = Hand.load("paper", gravity=np.array([0.0, 0.0, -9.81]))
THETA = np.tile([1.047, 0.0, 1.571], 3)
STILL = np.zeros(9)
TORQUE = HAND.gravity_torque(THETA) + np.linspace(-0.2, 0.2, 9)


def guard(**changes) -> JointGuard:
    return JointGuard(GuardConfig().changed(changes), HAND, TICK)


def step(made, tick, command=None, *, answers=None, theta=THETA, rates=STILL, refused=""):
    """Step at a tick with a torque that answers it, or an earlier one."""
    if command is not None:
        command = TorqueCommand((tick if answers is None else answers) * TICK, np.asarray(command))
    return made.step(tick * TICK, theta, rates, command, refused)


def follow(made, ticks=6):
    for tick in range(ticks):
        step(made, tick, TORQUE)
    return ticks


def test_good_commands_pass_to_the_bit():
    made = guard()
    for tick in range(3):
        np.testing.assert_array_equal(step(made, tick, TORQUE), TORQUE)
    assert not made.reason and not made.holding and made.held == 0


def test_commands_act_until_they_are_older_than_the_limit():
    made = guard()
    last = follow(made) - 1
    for late in (1, 2, 3):
        np.testing.assert_array_equal(step(made, last + late, TORQUE, answers=last), TORQUE)
        assert not made.reason and made.age == late
    step(made, last + 4, TORQUE, answers=last)
    assert made.reason == joint_guard.LATE and made.holds == {joint_guard.LATE: 1}


@pytest.mark.parametrize(
    ("command", "changes", "reason"),
    [
        (TORQUE, {"answers": 7}, joint_guard.AHEAD),
        (TORQUE[:8], {}, joint_guard.WRONG_SHAPE),
        (np.where(np.arange(9) == 4, np.nan, TORQUE), {}, joint_guard.NOT_FINITE),
        (np.full(9, np.inf), {}, joint_guard.NOT_FINITE),
        (TORQUE, {"rates": np.full(9, 21.0)}, joint_guard.TOO_FAST),
        (None, {}, joint_guard.NO_COMMAND),
        (TORQUE, {"refused": "a second sender"}, "a second sender"),
    ],
)
def test_what_is_wrong_begins_a_hold_and_is_named(command, changes, reason):
    made = guard()
    answer = step(made, follow(made), command, **changes)
    assert made.reason == reason and made.held == 1 and np.isfinite(answer).all()


def test_a_command_that_turns_the_squeeze_around_begins_a_hold_and_one_that_lets_go_does_not():
    weight = HAND.gravity_torque(THETA)
    for pull, reason in ((-1.0, joint_guard.PULLS), (-0.1, ""), (0.0, "")):
        made = guard(**{"hold.reserve": 0.0})
        answer = step(made, follow(made), weight + pull * (TORQUE - weight))
        assert made.reason == reason
    made = guard(**{"hold.reserve": 0.0})
    answer = step(made, follow(made), weight - (TORQUE - weight))
    np.testing.assert_allclose(answer, TORQUE, atol=1e-9)


def test_joint_states_that_are_not_finite_repeat_the_last_torque():
    made = guard()
    last = follow(made)
    np.testing.assert_array_equal(step(made, last, TORQUE, theta=np.full(9, np.nan)), TORQUE)
    assert made.reason == joint_guard.BLIND


def test_torques_stay_inside_the_limits_of_the_urdf():
    made = guard()
    np.testing.assert_array_equal(step(made, 0, np.full(9, 1e308)), np.full(9, 20.0))
    assert not made.reason


def test_a_limited_change_is_followed_at_that_rate():
    made = guard(torque_rate=50.0)  # 0.1 N m a tick
    last = follow(made)
    np.testing.assert_allclose(step(made, last, TORQUE - 1.0), TORQUE - 0.1)
    np.testing.assert_allclose(step(made, last + 1, TORQUE - 1.0), TORQUE - 0.2)


def test_a_fast_joint_is_held_until_it_is_clearly_slower():
    made = guard(speed_limit=1.0)
    fast = np.where(np.arange(9) == 3, 1.1, 0.0)
    step(made, 0, TORQUE, rates=fast)
    step(made, 1, TORQUE, rates=0.8 * fast)
    assert made.reason == joint_guard.TOO_FAST
    step(made, 2, TORQUE, rates=0.7 * fast)
    assert not made.reason


def test_at_rest_the_hold_answers_with_the_torque_that_was_there():
    """Gravity is carried and the squeeze is kept, apart from its reserve."""
    made = guard(**{"hold.reserve": 0.0})
    last = follow(made) - 1
    np.testing.assert_allclose(step(made, last + 9, TORQUE, answers=last), TORQUE, atol=1e-12)


def test_the_posture_of_the_first_held_tick_is_kept():
    made = guard(**{"hold.reserve": 0.0, "hold.squeeze_limit": 0.0})
    last = follow(made) - 1
    step(made, last + 4, TORQUE, answers=last)
    pushed = THETA + 0.01
    for late in range(5, 9):
        answer = step(made, last + late, TORQUE, answers=last, theta=pushed)
    spring = 100.0**2 * HAND.dynamics(pushed, STILL)[1] @ np.full(9, -0.01)
    change = HAND.gravity_torque(pushed) - HAND.gravity_torque(THETA)
    limit = HAND.effort_limits
    np.testing.assert_allclose(answer, np.clip(TORQUE + change + spring, -limit, limit), atol=1e-9)


def test_before_the_first_command_gravity_is_carried():
    np.testing.assert_allclose(step(guard(), 0), HAND.gravity_torque(THETA), atol=1e-12)


def test_commands_take_over_without_a_jump():
    made = guard(blend_time=0.02)
    tick = follow(made) + 9
    torques = [step(made, tick, TORQUE, answers=0)]
    wanted = TORQUE - 1.0
    for more in range(1, 12):
        torques.append(step(made, tick + more, wanted))
    assert np.abs(np.diff(torques, axis=0)).max() < 0.15
    np.testing.assert_array_equal(torques[-1], wanted)
    assert not made.holding


def test_bad_commands_while_taking_over_hold_on_without_another_reserve():
    made = guard()
    tick = follow(made) + 9
    held = step(made, tick, TORQUE, answers=0)
    step(made, tick + 1, TORQUE)
    again = step(made, tick + 2, TORQUE, answers=0)
    np.testing.assert_allclose(again, held, atol=1e-9)
    assert made.holds == {joint_guard.LATE: 2}


def test_a_torque_that_stays_the_same_while_the_joints_move_is_no_answer():
    """New stamps on an old torque: a controller, or what is between, that is stuck."""
    made = guard()
    tick = follow(made)
    for more in range(4):
        step(made, tick + more, TORQUE, theta=THETA + 0.0006 * more)
        assert not made.reason
    step(made, tick + 4, TORQUE, theta=THETA + 0.0024)
    step(made, tick + 5, TORQUE, theta=THETA + 0.0024)
    assert made.reason == joint_guard.STUCK and made.holds == {joint_guard.STUCK: 1}
    step(made, tick + 6, TORQUE + 1e-9, theta=THETA + 0.0024)
    assert not made.reason


def test_a_torque_may_stay_the_same_while_the_joints_rest():
    made = guard()
    for tick in range(200):
        step(made, tick, TORQUE)
    assert not made.holds


def held_after(made, tick, good):
    """Send a late command and then good ones; return for how many of these the joints are held."""
    step(made, tick, TORQUE, answers=tick - 4)
    held = 0
    for more in range(1, good + 1):
        step(made, tick + more, TORQUE)
        held += bool(made.reason)
    return held


def test_holds_that_follow_each_other_last_longer_and_longer():
    """On a computer that is too busy the hand stands still, and is not passed to and fro."""
    made = guard(patience=0.1)
    tick = follow(made)
    held = []
    for _ in range(6):
        held.append(held_after(made, tick, 60))
        tick += 61
    assert held == [0, 10, 20, 40, 50, 50]  # ticks of 2 ms
    assert made.holds == {joint_guard.LATE: 6}
    for _ in range(260):
        step(made, tick, TORQUE)
        tick += 1
    assert held_after(made, tick, 60) == 0


def test_commands_that_are_never_good_for_long_do_not_take_over_any_more():
    made = guard()
    tick = follow(made)
    for _ in range(8):
        held_after(made, tick, 20)
        tick += 21
    assert held_after(made, tick, 20) == 20 and made.reason == joint_guard.UNSTEADY


def test_reset_forgets_everything():
    made = guard()
    step(made, follow(made) + 9, TORQUE, answers=0)
    made.reset()
    assert not made.reason and not made.holding and made.held == 0 and made.age == -1
    np.testing.assert_array_equal(step(made, 0, TORQUE), TORQUE)
