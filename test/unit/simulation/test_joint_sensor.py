# SPDX-License-Identifier: Apache-2.0
"""Encoders: resolution, noise, filtered rates, and repeatability."""

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.joint_sensor import EncoderConfig, JointSensor

THETA, RATES, EFFORT = np.array([0.1, -2.0, 7.0]), np.array([1.0, -2.0, 0.5]), np.arange(3.0)
TICK = 0.002


@pytest.mark.parametrize("bits", [8, 20])
def test_an_angle_is_reported_to_half_a_step_and_small_motions_are_not_seen(bits):
    sensor, step = JointSensor(EncoderConfig(bits=bits), 0.0, TICK, 1), 2 * np.pi / 2**bits
    angles = np.linspace(-4.0, 4.0, 5_000)
    seen = np.array([sensor.step(np.array([a]), np.zeros(1), np.zeros(1)).theta[0] for a in angles])
    assert np.abs(seen - angles).max() <= 0.5 * step * (1 + 1e-9)
    assert abs((seen - angles).mean()) < 0.05 * step
    np.testing.assert_allclose(np.round(seen / step - 0.5), seen / step - 0.5, atol=1e-6)


def test_a_rate_follows_the_differences_of_angles_with_the_corner_frequency():
    cutoff, speed = 30.0, 3.0
    sensor = JointSensor(EncoderConfig(bits=24, rate_cutoff=cutoff), 0.0, TICK, 1)
    for n in range(8):
        reported = sensor.step(np.array([speed * n * TICK]), np.zeros(1), np.zeros(1))
        expected = speed * -np.expm1(-2 * np.pi * cutoff * n * TICK)
        assert reported.rates[0] == pytest.approx(expected, abs=1e-3)


def test_noise_has_its_size_and_repeats_after_a_reset():
    sensor = JointSensor(EncoderConfig(noise=0.003), 0.02, TICK, 1)

    def readings():
        return [sensor.step(THETA, RATES, EFFORT) for _ in range(3000)]

    first = readings()
    assert np.std([r.theta for r in first], axis=0) == pytest.approx(0.003, rel=0.1)
    assert np.std([r.applied for r in first], axis=0) == pytest.approx(0.02, rel=0.1)
    sensor.reset()
    for before, again in zip(first, readings(), strict=True):
        for a, b in zip(before, again, strict=True):
            np.testing.assert_array_equal(a, b)


def test_the_noise_of_joints_is_not_that_of_the_skin():
    """The skin draws from its seed, and from a second stream of it."""
    noise = JointSensor(EncoderConfig(noise=1.0), 0.0, TICK, 4).step(THETA, RATES, EFFORT).theta
    for stream in (4, [4, 1]):
        skin = np.random.default_rng(stream).standard_normal(3)
        assert not np.allclose(noise - THETA, skin)


def test_the_controllers_see_what_the_encoders_report():
    coarse = load_scenario("hold", {"plant.encoder.bits": 10})
    loop = ClosedLoop(coarse)
    record = loop.run(50)
    steps = record.theta / (2 * np.pi / 2**10) - 0.5
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert not np.array_equal(loop.state.theta, loop.state.joints.theta)
