# SPDX-License-Identifier: Apache-2.0
"""Joint rates from encoder angles: right at every speed, zero at rest."""

import numpy as np
import pytest

from tactile_hand_ros.control.sensing import JointRates

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


def test_an_angle_that_flickers_between_two_steps_is_at_rest():
    """A 100 Hz filter would report pulses of 0.18 rad/s."""
    random = np.random.default_rng(3)
    angles = 40 * STEP + STEP * random.integers(-1, 1, 500) + 0.5 * STEP
    assert np.abs(rates_of(angles)[64:, 0]).max() <= 1.01 * STEP / 0.063


def test_a_start_is_seen_after_a_few_ticks():
    """1 rad/s is nearly three steps per tick."""
    angles = 0.3 + np.maximum(0.0, 1e-3 * (np.arange(120) - 100))
    found = rates_of(angles)[:, 0]
    assert abs(found[100]) < 0.01 and found[104] == pytest.approx(1.0, abs=0.2)


def test_the_lag_at_an_acceleration_is_that_of_the_window():
    """20 rad/s^2: sqrt(8 e / a) = 12 ms, and the slope lags by half of that."""
    times = 1e-3 * np.arange(300)
    late = 20.0 * times - rates_of(10.0 * times**2)[:, 0]
    assert 0.0 < late[100:].mean() < 20.0 * 0.5 * 0.0125 + STEP / 0.0125


def test_exact_angles_and_a_first_tick_leave_the_measured_rates():
    made, measured = JointRates(2), np.array([1.0, -2.0])
    for stamp in (0, TICK):
        assert made.step(stamp, np.full(2, 0.1 * stamp), measured, 0.0) is measured
    assert made.step(2 * TICK, np.zeros(2), measured, STEP) is measured


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
