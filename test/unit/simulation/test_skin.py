# SPDX-License-Identifier: Apache-2.0
"""The simulated skin: exact without errors, and each type of error."""

import numpy as np
import pytest
from scipy.signal import lfilter
from support.grasps import HALF

from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.control.contact import contact_frame
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.rotations import quaternion_from_rotation, rows_of_quaternions
from tactile_hand_ros.simulation.skin import TactileReading, TactileSensor, TactileSensorConfig

RADII = np.array([0.06, 0.03, 0.05])
TICK = 2_000_000


def truth(time=0.0, missing=()):
    """Return true contacts that move slowly, and forces that encode their time."""
    points = HALF * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    positions = points + [0.0, 0.0, 0.01 * time]
    quaternions = quaternion_from_rotation([contact_frame(-p / HALF) for p in points])
    forces = np.array([[0.1, 5.0, -0.2]] * 3) + [0.0, time, 0.0]
    for finger in missing:
        positions[finger] = quaternions[finger] = np.nan
        forces[finger] = 0.0
    return TactileReading(positions, quaternions, forces)


def sensor(**values):
    return TactileSensor(TactileSensorConfig(**values), RADII)


def readings(skin, ticks, missing=()):
    """Return the skin's output at each of the ticks."""
    return [skin.step(i * TICK, truth(1e-9 * i * TICK, missing)) for i in range(ticks)]


def same(one, two):
    for name in ("positions", "quaternions", "forces"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_perfect_skin_reports_the_truth_to_the_bit():
    for i, reading in enumerate(readings(sensor(), 5)):
        same(reading, truth(1e-9 * i * TICK))


def test_a_skin_for_normal_forces_measures_them_as_any_other_and_says_that_it_knows_no_more():
    noise = {"force_noise": 0.1, "dropout": 0.3, "bias_drift": 0.1}
    whole, normal = (readings(sensor(**noise, axes=axes), 20, (1,)) for axes in ("all", "normal"))
    for one, other in zip(whole, normal, strict=True):
        np.testing.assert_array_equal(other.forces[:, 1], one.forces[:, 1])
        assert np.isnan(other.forces[:, ::2]).all()
        np.testing.assert_array_equal(other.positions, one.positions)


def test_one_seed_gives_the_same_noise_and_another_gives_other():
    noisy = {"force_noise": 0.1, "location_noise": 0.001, "dropout": 0.3, "bias_drift": 0.1}
    noisy |= {"bandwidth": 40.0, "location_bandwidth": 20.0, "latency": 0.004}
    first, again, other = (readings(sensor(**noisy, seed=seed), 50) for seed in (5, 5, 6))
    for one, two in zip(first, again, strict=True):
        same(one, two)
    assert np.abs(first[0].forces - other[0].forces).max() > 1e-3
    skin = sensor(**noisy, seed=5)
    readings(skin, 20)
    skin.reset()
    for one, two in zip(first, readings(skin, 50), strict=True):
        same(one, two)


def test_a_repeated_tick_repeats_the_reading():
    skin = sensor(force_noise=0.1)
    skin.step(0, truth())
    once = skin.step(TICK, truth())
    same(skin.step(TICK, truth()), once)


def test_no_contact_is_nan_without_force_however_noisy():
    noisy = {"force_noise": 0.5, "location_noise": 0.01, "location_resolution": 0.003}
    for reading in readings(sensor(**noisy), 10, missing=[0, 2]):
        assert np.isnan(reading.positions[[0, 2]]).all()
        assert np.isnan(reading.quaternions[[0, 2]]).all()
        assert not reading.forces[[0, 2]].any()
        np.testing.assert_array_equal(reading.contacts.touching, [False, True, False])


def test_a_reading_is_as_old_as_the_latency():
    skin = sensor(latency=0.01)
    for i, reading in enumerate(readings(skin, 20)):
        expected = max(0.0, 0.002 * i - 0.01)
        assert reading.forces[0, 1] == pytest.approx(5.0 + expected, abs=1e-12)


@pytest.mark.parametrize(("rate", "every"), [(100.0, 5), (500.0, 1), (1000.0, 1), (3000.0, 1)])
def test_a_slow_skin_repeats_its_last_sample_and_one_as_fast_as_the_ticks_misses_none(rate, every):
    forces = [r.forces[0, 1] - 5.0 for r in readings(sensor(rate=rate), 2000)]
    np.testing.assert_allclose(forces, 0.002 * every * (np.arange(2000) // every), atol=1e-12)


def test_a_location_settles_with_its_time_constant_and_a_new_one_shows_at_once():
    """Three tips of different sizes; under each, the contact jumps by 0.3 rad."""
    here, there = truth(), np.array([[-1.0, 0.0, 0.3], [1.0, 0.3, 0.0], [0.0, -1.0, -0.3]])
    there /= np.linalg.norm(there, axis=1)[:, None]
    frames = quaternion_from_rotation([contact_frame(n) for n in there])
    turned = TactileReading(here.positions, frames, here.forces)
    skin = sensor(rate=1000.0, location_bandwidth=20.0)

    def shows(tick, true):
        return skin.step(tick * 1_000_000, true).contacts.normals

    old = shows(0, here)
    for tick in range(1, 20):
        expected = there + np.exp(-2.0 * np.pi * 20.0 * 1e-3 * tick) * (old - there)
        expected /= np.linalg.norm(expected, axis=1)[:, None]
        np.testing.assert_allclose(shows(tick, turned), expected, atol=1e-7)
    assert np.isnan(shows(20, truth(missing=[1]))[1]).all()
    back = shows(21, here)
    np.testing.assert_allclose(back[1], old[1], atol=1e-7)  # lost in between, reported immediately
    assert np.abs(back[0] - old[0]).max() > 0.1  # the others continue settling


def band(white, low, high, rate):
    """Return band-limited noise from white noise, shape (n, ...), by filters of SciPy."""
    quick, slow = (1.0 - np.exp(-2.0 * np.pi * corner / rate) for corner in (high, low))

    def passed(signal):
        first = lfilter([quick], [1.0, quick - 1.0], signal, axis=0)
        return first - lfilter([slow], [1.0, slow - 1.0], first, axis=0)

    return passed(white) / np.linalg.norm(passed(np.eye(1, 2000)[0]))


def test_all_that_a_skin_adds_to_a_force_adds_up_in_order():
    """Vibration, bandwidth, drift and noise, each with its own stream of the seed."""
    period, ticks, speeds = 1e-3, 40, np.array([0.02, 0.0, 0.3])
    errors = {"force_noise": 0.05, "bias_drift": 0.3, "bandwidth": 90.0}
    errors |= {"vibration": {"gain": 10.0, "limit": 0.2, "low": 60.0, "high": 400.0}}
    skin = sensor(rate=1000.0, seed=7, **errors)
    still = truth()
    frames = rows_of_quaternions(still.quaternions).reshape(-1, 3, 3)
    random = np.random.default_rng(7)
    drawn = [(random.standard_normal((4, 3, 3)), random.random(3))[0] for _ in range(ticks)]
    shaking = band(np.array(drawn)[:, 1], 60.0, 400.0, 1000.0)
    rms = 0.2 * (1.0 - np.exp(-10.0 / 0.2 * speeds))
    share, zero, before = 1.0 - np.exp(-2.0 * np.pi * 90.0 * period), np.zeros((3, 3)), None
    for i in range(ticks):
        pressed = np.array([[0.0, 5.0 * (1.0 + 0.1 * i), 0.0]] * 3)
        true = TactileReading(still.positions, still.quaternions, pressed)
        found = skin.step(i * 1_000_000, true, speeds).forces
        force = pressed + rms[:, None] * shaking[i]
        before = force if before is None else before + share * (force - before)
        zero = zero + 0.3 * np.sqrt(period) * drawn[i][2]
        drift = np.einsum("kji,kj->ki", frames, zero)  # the zero drifts in palm axes
        np.testing.assert_allclose(found, before + drift + 0.05 * drawn[i][3], atol=1e-12)


@pytest.mark.parametrize("bandwidth", [0.0, 20.0])
@pytest.mark.parametrize(("pause", "unread"), [(5, 4), (100, 99), (101, 99), (700, 99)])
def test_of_a_pause_a_second_of_samples_is_made_up_for(pause, unread, bandwidth):
    """Band edges above half the rate are clipped to it; a low-pass takes each sample in turn."""
    skin = sensor(rate=100.0, seed=4, bandwidth=bandwidth, vibration={"gain": 10.0, "limit": 0.2})
    sliding, still = np.ones(3), truth()
    sensed = skin.step(0, still, sliding).forces - still.forces
    found = skin.step(pause * 10_000_000, still, sliding).forces - still.forces
    read, others = np.random.default_rng(4), np.random.default_rng([4, 1])
    first = read.standard_normal((4, 3, 3))[1:2]
    read.random(3)
    last = read.standard_normal((4, 3, 3))[1:2]
    white = np.concatenate([first, others.standard_normal((unread, 3, 3)), last])
    shaking = 0.2 * (1.0 - np.exp(-50.0)) * band(white, 45.0, 50.0, 100.0)
    np.testing.assert_allclose(sensed, shaking[0], atol=1e-12)
    expected, follow = sensed, -np.expm1(-2.0 * np.pi * bandwidth / 100.0)
    for sample in shaking[1:]:
        expected = expected + follow * (sample - expected) if bandwidth else sample
    is_long = bandwidth and pause > unread + 1  # then older readings have decayed further
    np.testing.assert_allclose(found, expected, atol=1e-4 if is_long else 1e-12)


def test_a_location_is_displaced_then_rounded_then_smoothed():
    errors = {"location_noise": 0.003, "location_resolution": 0.002, "location_bandwidth": 50.0}
    skin = sensor(rate=1000.0, seed=9, **errors)
    normals, random, before = truth().contacts.normals, np.random.default_rng(9), None
    centers = truth().positions - RADII[:, None] * normals
    share = 1.0 - np.exp(-2.0 * np.pi * 50.0 * 1e-3)
    for i in range(20):
        found = skin.step(i * 1_000_000, truth())
        white = random.standard_normal((4, 3, 3))[0]
        random.random(3)
        arms = 0.002 * np.rint((RADII[:, None] * normals + 0.003 * white) / 0.002)
        before = arms if before is None else before + share * (arms - before)
        seen = before / np.linalg.norm(before, axis=1)[:, None]
        np.testing.assert_allclose(found.positions, centers + RADII[:, None] * seen, atol=1e-12)
        frames = np.array([contact_frame(n) for n in seen])
        np.testing.assert_allclose(found.contacts.rotations, frames, atol=1e-9)


def test_a_sample_is_lost_where_its_luck_is_below_the_chance():
    skin, random = sensor(rate=1000.0, seed=3, dropout=0.4), np.random.default_rng(3)
    last = np.zeros(3)
    for i in range(60):
        random.standard_normal((4, 3, 3))
        luck = random.random(3)
        last = np.where((luck < 0.4) & (i > 0), last, 5.0 + 0.001 * i)
        found = skin.step(i * 1_000_000, truth(0.001 * i)).forces[:, 1]
        np.testing.assert_allclose(found, last, atol=1e-12)


def test_one_finger_without_contact_leaves_the_others_noise_alone():
    whole = readings(sensor(force_noise=0.1, location_noise=0.001), 20)
    part = readings(sensor(force_noise=0.1, location_noise=0.001), 20, missing=[1])
    for one, two in zip(whole, part, strict=True):
        np.testing.assert_array_equal(one.forces[[0, 2]], two.forces[[0, 2]])
        np.testing.assert_array_equal(one.positions[[0, 2]], two.positions[[0, 2]])


def test_each_finger_has_its_own_fault():
    skin, whole = sensor(), readings(sensor(), 3)
    (first,) = readings(skin, 1)
    same(first, whole[0])
    skin.configure(TactileSensorConfig(faults=["off", "stuck", "wrong"]))
    for i in (1, 2):
        found = skin.step(i * TICK, truth(1e-9 * i * TICK))
        assert np.isnan(found.positions[0]).all() and not found.forces[0].any()
        for one, then, now in zip(found, whole[0], whole[i], strict=True):
            np.testing.assert_array_equal(one[1], then[1])
        np.testing.assert_array_equal(found.positions[2], whole[i].positions[2])
        np.testing.assert_allclose(found.forces[2], 3.0 * whole[i].forces[2])
    skin.configure(TactileSensorConfig(faults=["none"] * 3))
    same(skin.step(3 * TICK, truth(3e-9 * TICK)), truth(3e-9 * TICK))


def test_a_lost_sample_of_a_wrong_finger_repeats_the_last():
    first, *later = readings(sensor(dropout=1.0, faults=["wrong"] * 3), 3)
    np.testing.assert_allclose(first.forces, 3.0 * truth().forces)
    for reading in later:
        same(reading, first)


def test_the_first_sample_of_a_stuck_finger_is_the_true_one():
    same(readings(sensor(faults=["stuck"] * 3), 1)[0], truth())


def test_off_needs_no_quotes_in_yaml():
    text = "{faults: [off, none, 'off']}"
    assert TactileSensorConfig(**parse_yaml(text)).faults == ["off", "none", "off"]


@pytest.mark.parametrize("faults", [["off"], ["off"] * 4])
def test_faults_of_another_number_of_fingers_are_refused(faults):
    with pytest.raises(ConfigurationError, match="each of 3 fingers"):
        sensor(faults=faults)
    skin = sensor()
    with pytest.raises(ConfigurationError, match="each of 3 fingers"):
        skin.configure(TactileSensorConfig(faults=faults))
    same(readings(skin, 1)[0], truth())
