# SPDX-License-Identifier: Apache-2.0
"""Rates of joints, the delay of their torques, and the age of contact points."""

import numpy as np
import pytest
from support.controllers import Bench
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.sensing import JointRates, LateTouch, TorqueDelay

HAND, START = plant().hand, plant().state.theta
LARGEST, ERROR, PERIOD = 0.03, 1e-4, 0.002  # s, rad, s
FRAMES = plant().state.contacts.rotations
NORMALS = FRAMES[:, :, 1]
OFFSET = np.array([[1.0, -2.0, 0.5], [0.0, 1.5, -1.0], [2.0, 0.0, 1.0]]) * 1e-3  # of the skin, m


def angles(time, speed):
    """Return joint angles, rad, and their rates, rad/s, of at most `speed`."""
    pace = np.linspace(5.0, 9.0, 9)  # rad/s
    return START + speed / pace * np.sin(pace * time), speed * np.cos(pace * time)


def found(true, *, speed=0.3, noise=0.0, age=0.0, samples=300):
    """Return the age found for contacts that are `true` s old."""
    watch, random = LateTouch(HAND), np.random.default_rng(4)
    watch.age = age
    for time in PERIOD * np.arange(samples):
        theta, rates = angles(time, speed)
        tips, before = HAND.fingertips(theta), HAND.fingertips(angles(time - true, speed)[0])
        measured = before.positions + HAND.radii[:, None] * NORMALS + OFFSET
        contacts = Contacts(measured + random.normal(0.0, noise, (3, 3)), FRAMES)
        seen = theta, rates, tips, contacts, np.ones(3, dtype=bool)
        watch.step(round(1e9 * time), *seen, PERIOD, LARGEST, ERROR)
    return watch.age


@pytest.mark.parametrize("true", [0.0, 0.004, 0.013, 0.03])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_the_age_of_touch_is_found_whatever_the_offset_of_the_skin(true, noise):
    assert found(true, noise=noise) == pytest.approx(true, abs=1e-3)


def test_the_age_is_never_negative_nor_above_the_largest_nor_made_of_noise():
    assert found(-0.01) == 0.0
    assert found(0.05) == LARGEST
    assert found(0.0, speed=3.0 * ERROR / LARGEST, noise=1e-3) < 1e-3


def test_motions_that_show_nothing_beyond_the_error_of_the_angles_change_nothing():
    assert found(0.0, speed=0.5 * ERROR / LARGEST, age=0.01) == 0.01
    assert found(0.0, age=0.01) == 0.0


def follow(bench, ticks, age, missing=()):
    """Answer ticks with contacts that the fingers carry, of some age in s; return torques."""
    torques, touch = [], (bench.contacts.positions, bench.contacts.rotations)
    for _ in range(ticks):
        time = 1e-9 * bench.stamp
        theta, rates = angles(time, 0.3)
        moved = angles(time - age, 0.3)[0] - START
        contacts = Contacts(*carried_along(HAND.fingertips(START), *touch, moved))
        contacts.positions[list(missing)] = contacts.rotations[list(missing)] = np.nan
        torques.append(bench.step(theta=theta, rates=rates, contacts=contacts).torque)
    return np.array(torques)


def test_the_law_takes_late_contacts_where_they_are_now():
    """Also between two ticks, and soon after a finger was lost."""
    late, fresh = Bench(), Bench()
    follow(late, 1, 0.0), follow(fresh, 1, 0.0)
    found, wanted = follow(late, 100, 0.005), follow(fresh, 100, 0.0)
    np.testing.assert_allclose(found[3:], wanted[3:], atol=5e-4)  # without: 4.4e-3 N m
    follow(late, 3, 0.005, missing=[1]), follow(fresh, 3, 0.0, missing=[1])
    found, wanted = follow(late, 6, 0.005), follow(fresh, 6, 0.0)
    np.testing.assert_allclose(found[3:], wanted[3:], atol=5e-4)


def test_a_reset_forgets_the_age_and_time_may_go_back():
    bench, new = Bench(), Bench()
    follow(bench, 50, 0.006)
    bench.stamp -= 20_000_000
    assert np.isfinite(follow(bench, 20, 0.006)).all()
    bench.controller.reset()
    bench.stamp = new.stamp = 0
    np.testing.assert_array_equal(follow(bench, 30, 0.006), follow(new, 30, 0.006))


STEP = 2.0 * np.pi / 2**14
TICK = 1_000_000  # ns
NONE = np.full(2, np.nan)  # measured rates must not matter


def rates_of(angles, tick=TICK, error=STEP):
    """Return the rates at each tick of two joints, the second with half the angle of the first."""
    made = JointRates(2)
    seen = (np.floor(np.outer(angles, [1.0, 0.5]) / STEP) + 0.5) * STEP
    return np.array([made.step(i * tick, row, NONE, error) for i, row in enumerate(seen)])


@pytest.mark.parametrize("speed", [0.01, -0.1, 1.0, 10.0])
@pytest.mark.parametrize("tick", [TICK // 2, 10 * TICK])
def test_a_constant_speed_is_found_to_a_step_over_the_window(speed, tick):
    times = 1e-9 * tick * np.arange(200)
    found = rates_of(0.3 + speed * times, tick)[64:]
    allowed = 2.0 * STEP / (63 * 1e-9 * tick)
    np.testing.assert_allclose(found[:, 0], speed, atol=allowed)
    np.testing.assert_allclose(found[:, 1], 0.5 * speed, atol=allowed)


def test_an_angle_that_flickers_between_two_steps_is_at_rest_and_a_start_is_seen_soon():
    """A 100 Hz filter would report pulses of 0.18 rad/s. 1 rad/s is nearly 3 steps a tick."""
    random = np.random.default_rng(3)
    angles = 40 * STEP + STEP * random.integers(-1, 1, 500) + 0.5 * STEP
    assert np.abs(rates_of(angles)[64:, 0]).max() <= 1.01 * STEP / 0.063
    found = rates_of(0.3 + np.maximum(0.0, 1e-3 * (np.arange(120) - 100)))[:, 0]
    assert abs(found[100]) < 0.01 and found[104] == pytest.approx(1.0, abs=0.2)


def test_the_rate_is_the_middle_of_all_slopes_that_fit():
    """Four ticks after a step, slopes from 0 to a third of a step a tick do, not only a fourth."""
    found = rates_of(STEP * np.array([0.5, 1.5, 1.5, 1.5, 1.5]))[-1, 0]
    assert found == pytest.approx(STEP / 6.0 / 1e-3, rel=0.02)


def test_the_lag_at_an_acceleration_is_that_of_the_window():
    """20 rad/s^2: sqrt(2 e a) = 0.124 rad/s."""
    times = 1e-3 * np.arange(300)
    late = 20.0 * times - rates_of(10.0 * times**2)[:, 0]
    assert 0.0 < late[100:].mean() < 20.0 * 0.5 * 0.0125 + STEP / 0.0125


def test_exact_angles_and_a_first_tick_leave_the_measured_rates():
    made, measured = JointRates(2), np.array([1.0, -2.0])
    for stamp in (0, TICK):
        assert made.step(stamp, np.full(2, 0.1 * stamp), measured, 0.0) is measured
    assert made.step(2 * TICK, np.zeros(2), measured, STEP) is measured


def test_exact_angles_have_exact_rates_also_after_coarse_ones():
    made, measured = JointRates(2), np.array([1.0, -2.0])
    for tick in range(5):
        made.step(tick * TICK, tick * measured, measured, STEP)
    assert (made.error > 0.0).all()
    np.testing.assert_array_equal(made.step(5 * TICK, 5 * measured, measured, 0.0), measured)
    np.testing.assert_array_equal(made.error, 0.0)


def test_a_repeated_tick_changes_nothing_and_an_earlier_one_starts_over():
    made, measured = JointRates(1), np.array([7.0])
    for i in range(10):
        first = made.step(i * TICK, np.array([0.01 * i]), measured, STEP)
    np.testing.assert_array_equal(made.step(9 * TICK, np.array([0.09]), measured, STEP), first)
    assert first[0] == pytest.approx(10.0)
    assert made.step(3 * TICK, np.array([5.0]), measured, STEP) is measured
    made.step(4 * TICK, np.array([5.01]), measured, STEP)
    made.reset()
    assert made.step(5 * TICK, np.array([9.0]), measured, STEP) is measured


TORQUE_OFFSET = np.array([0.3, -0.2, 0.1])  # of the reported torques, N m


def sent(delay, true, noise=0.0, ticks=200, seed=3):
    """Send torques that change by 10 mN m a tick; the joints apply them `true` ticks late."""
    random = np.random.default_rng(seed)
    torques = np.cumsum(random.normal(0.0, 0.01, (ticks, 3)), axis=0)
    for tick in range(ticks):
        acted = torques[max(0, tick - 1 - true)] + TORQUE_OFFSET
        delay.step(acted + random.normal(0.0, noise, 3) if tick else None)
        delay.sent(torques[tick])
    return delay.ticks


@pytest.mark.parametrize("true", [0, 1, 2, 3])
def test_the_delay_of_torques_is_found_whatever_the_offset_and_again_if_it_changes(true):
    delay = TorqueDelay(3, 3)
    assert sent(delay, true, noise=0.003) == delay.allowed == true
    delay.pause()  # another sender's torques, which are not compared
    delay.step(TORQUE_OFFSET)
    assert sent(delay, 3 - true) == 3 - true


def test_torques_that_are_unknown_stay_or_are_noise_show_no_delay():
    """The largest is allowed for."""
    delay = TorqueDelay(2, 3)
    assert sent(delay, 1, noise=0.05) is None
    for applied in (None, TORQUE_OFFSET):
        for _ in range(200):
            delay.step(applied)
            delay.sent(TORQUE_OFFSET)
    assert delay.ticks is None and delay.allowed == 2
