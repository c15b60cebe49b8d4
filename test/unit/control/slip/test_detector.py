# SPDX-License-Identifier: Apache-2.0
"""The slip detector alone, on forces made by hand."""

import numpy as np
import pytest

from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig

UNKNOWN, STICK, SLIP = ContactState.UNKNOWN, ContactState.STICK, ContactState.SLIP
DT, NORMAL = 0.001, np.array([[0.0, 1.0, 0.0]])
NOTHING = [np.nan] * 3


def run(forces, detector=None, own_change=0.0, friction=np.inf):
    """Return what a detector says of the forces of one contact, one a tick."""
    detector = detector or SlipDetector(SlipDetectorConfig(), 1)
    mu = np.array([friction])
    told = [
        detector.step(np.array([f]), NORMAL, own_change, DT if i else 0.0, mu)[0]
        for i, f in enumerate(forces)
    ]
    return np.array(told)


def sticking(ticks, noise=0.01, seed=0):
    random = np.random.default_rng(seed)
    return np.array([1.0, 5.0, 0.5]) + noise * random.standard_normal((ticks, 3))


def sliding(ticks, rms=0.15, seed=1):
    return sticking(ticks, rms, seed)


def test_noise_alone_raises_no_alarm_in_a_minute():
    told = run(sticking(60_000))
    assert (told[100:] == STICK).all()


def test_a_slow_skin_is_judged_by_its_samples_not_by_ticks():
    """One at 250 Hz under a loop at 1 kHz needs as many samples as one that is as slow as it."""
    samples = np.concatenate([sticking(300), sliding(20)])
    slow, fast = run(np.repeat(samples, 4, axis=0)), run(samples)
    assert 300 < (fast == SLIP).argmax() < 308
    later = (slow == SLIP).argmax() // 4 - (fast == SLIP).argmax()
    assert later in (0, 1)


def test_one_wild_sample_of_a_slow_skin_is_no_slip():
    samples = sticking(500)
    samples[300, 0] += 0.5
    assert not (run(np.repeat(samples, 4, axis=0), friction=0.1) == SLIP).any()


def test_even_at_the_brink_a_push_is_no_slip():
    forces = sticking(1000)
    forces[500:, 0] += 3.0
    assert not (run(forces, friction=0.2) == SLIP).any()


def test_the_newest_sample_tells_sooner_than_the_sum_that_it_has_stopped():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    run(np.concatenate([sticking(500), sliding(20)]), detector)
    assert detector.state == [SLIP]
    run(sticking(4, seed=9), detector)
    assert detector.state == [SLIP] and not detector.agrees[0]


def test_what_lasts_is_learned_as_noise():
    told = run(np.concatenate([sticking(500), sliding(8000, rms=0.05)]))
    assert (told[500:800] == SLIP).any() and not (told[-1000:] == SLIP).any()


EVEN = np.array([[1.0, 2.0, 0.0], [0.5, 5.0, 0.0], [-1.0, 8.0, 0.0]]) + np.array(
    [[[i / 1024.0, 0.0, i / 1024.0]] for i in range(100)]
)
FLOOR = np.sqrt(6.0 * (0.002**2 + (0.002 * np.array([2.0, 5.0, 8.0])) ** 2))


def kinked(kinks, axes=None, own_change=0.0, friction=(np.inf,) * 3, **values):
    """Return a detector of three contacts after one kink of each force in otherwise even ones.

    The even ones are binary fractions, so that until then no second difference is anything but 0.
    """
    detector = SlipDetector(SlipDetectorConfig(noise=1e-6, **values), 3)
    axes = np.tile(NORMAL, (3, 1)) if axes is None else np.asarray(axes)
    for forces in EVEN[:-1]:
        detector.step(forces, axes, 0.0, DT, np.array(friction))
    assert not detector.evidence.any() and (detector.state == STICK).all()
    detector.step(EVEN[-1] + kinks, axes, own_change, DT, np.array(friction))
    return detector


def evidence(power):
    """Return the log-likelihood ratio of a second difference of some power against its noise."""
    return 0.5 * (8.0 / 9.0 * np.asarray(power) - 2.0 * np.log(9.0))


def across(*sizes):
    """Return changes of the forces by multiples of their noise, across their normals."""
    return np.array(
        [[a * s, 0.0, b * s] for s, a, b in zip(FLOOR, sizes, sizes[::-1], strict=True)]
    )


def test_a_change_counts_against_the_noise_of_each_normal_force():
    found = kinked(across(3.0, 2.4, 1.0)).evidence
    np.testing.assert_allclose(found, evidence([10.0, 2 * 2.4**2, 10.0]), rtol=0.01)
    assert (found > 1.0).all()
    np.testing.assert_array_equal(kinked(across(1.0, 1.0, 1.0)).evidence, 0.0)


def test_a_skin_without_relative_noise_has_a_fixed_floor():
    kinks = 0.002 * np.sqrt(6.0) * np.array([[2.8, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 3.3]])
    found = kinked(kinks, relative_noise=0.0).evidence
    np.testing.assert_allclose(found, evidence(np.array([2.8, 3.0, 3.3]) ** 2), rtol=0.01)


def test_three_parts_in_a_hundred_of_what_the_hand_has_bent_count_as_noise():
    kinks = across(3.0, 2.4, 1.0)
    louder = FLOOR**2 + (0.03 * 0.5) ** 2
    found = kinked(1.2 * kinks, own_change=0.5).evidence
    expected = evidence((1.2 * kinks**2 * 1.2).sum(axis=1) / louder)
    np.testing.assert_allclose(found, np.maximum(expected, 0.0), rtol=0.01)
    assert found[1] > 1.0 and (found < kinked(1.2 * kinks).evidence).all()
    np.testing.assert_array_equal(kinked(kinks, own_change=20.0).evidence, 0.0)


def test_one_sample_counts_for_a_quarter_of_the_threshold_and_for_a_third_at_the_brink():
    wild = across(300.0, 200.0, 400.0)
    felt = EVEN[-1] + wild
    ratios = np.hypot(felt[:, 0], felt[:, 2]) / felt[:, 1]
    for share, part in ((0.94, 3.0), (0.97, 4.0)):  # the brink is at 0.95 of the friction
        found = kinked(wild, friction=np.roll([1.0, np.inf, 1.0], 1) * ratios / share)
        told = np.where(np.roll([1, 0, 1], 1), 28.0 / (7.0 - part), 7.0)
        np.testing.assert_allclose(found.evidence, told)
        np.testing.assert_allclose(found.likelihood, told / 28.0)
        assert (found.state == STICK).all() and found.agrees.all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 40.0])
def test_the_direction_of_the_grasp_force_counts_and_not_its_length(scale):
    axes = scale * np.array([[0.3, 2.0, -0.4], [-0.5, 1.0, 0.2], [0.1, 0.5, 0.7]])
    units = axes / np.linalg.norm(axes, axis=1)[:, None]
    np.testing.assert_array_equal(kinked(0.5 * units, axes).evidence, 0.0)
    sides = np.cross(units, [0.6, 0.0, 0.8])
    sides *= 3.3 * FLOOR[:, None] / np.linalg.norm(sides, axis=1)[:, None]
    along = kinked(sides + 3.0 * units * FLOOR[:, None], axes).evidence
    np.testing.assert_allclose(along, evidence(3.3**2), rtol=0.08)  # the floor moves with f_n


def test_without_a_grasp_force_every_direction_counts():
    """Also that of the normal."""
    kinks = 3.3 * FLOOR[:, None] * np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0]])
    found = kinked(kinks, np.zeros((3, 3))).evidence
    np.testing.assert_allclose(found, evidence(3.3**2), rtol=0.08)  # the floor moves with f_n


def test_slip_is_told_above_the_threshold_and_until_three_quarters_of_it():
    detector = SlipDetector(SlipDetectorConfig(noise=1e-6), 1)
    steady = np.array([1.0, 5.0, 0.0]) + np.arange(100)[:, None] * [1 / 1024, 0.0, 0.0]
    run(steady, detector)
    jerks = steady[-1] + np.array([1.0, -1.0] * 5)[:, None] * [0.0, 0.0, 4.0]
    told = run(jerks, detector)  # a quarter of the threshold each; four of them are not above it
    np.testing.assert_array_equal(told, [STICK] * 4 + [SLIP] * 6)
    assert detector.evidence == pytest.approx(1.2 * 28.0) and detector.likelihood == 1.0
    last = jerks[-1] + np.arange(1, 12)[:, None] * [1 / 1024, 0.0, -8.0]  # continues evenly
    told = run(last, detector)
    # ln 9 less each time: 33.6 falls to 21 after 5.7 of them.
    np.testing.assert_array_equal(told, [SLIP] * 5 + [STICK] * 6)


def test_a_contact_is_known_from_the_least_force_on():
    for normal, state in ((0.05, UNKNOWN), (np.nextafter(0.05, 1.0), STICK)):
        forces = np.array([0.01, normal, 0.0]) + np.arange(100)[:, None] * [1 / 1024, 0.0, 0.0]
        assert run(forces)[-1] == state


def test_short_slips_one_after_the_other_are_not_learned_as_noise():
    """Half a second altogether, but none of them for longer than the patience."""
    detector = SlipDetector(SlipDetectorConfig(), 1)
    for i in range(5):
        run(sticking(300, seed=i), detector)
        told = run(sliding(100, rms=0.05, seed=50 + i), detector)
        assert np.mean(told == SLIP) > 0.85


def test_a_detector_that_was_reset_cannot_be_told_from_a_new_one():
    used, fresh = (SlipDetector(SlipDetectorConfig(), 1) for _ in range(2))
    run(np.concatenate([sticking(100), sliding(50)]), used)
    used.reset()
    assert used.state == [UNKNOWN] and used.evidence == used.likelihood == [0.0]
    assert not used.agrees[0]
    again = np.concatenate([sticking(80, seed=3), sliding(20, seed=4)])
    np.testing.assert_array_equal(run(again, used), run(again, fresh))
    assert used.evidence == fresh.evidence > 0.0


def at_stamps(forces, steps, detector=None):
    """Return what a detector says of forces that come at uneven steps, in ms."""
    detector = detector or SlipDetector(SlipDetectorConfig(), 1)
    mu = np.array([np.inf])
    return np.array(
        [
            detector.step(np.array([force]), NORMAL, 0.0, 1e-3 * step, mu)[0]
            for force, step in zip(forces, steps, strict=True)
        ]
    )


@pytest.mark.parametrize("gap", range(1, 51))
def test_a_gap_is_no_slip_whatever_the_load_did_in_it(gap):
    """Of 1 to 50 ticks, in which the load moved on by 3 N; the noise that was learned stays."""
    forces = sticking(600)
    forces[500:, 0] += 3.0
    forces[:, 2] += 0.02 * np.arange(600)  # and one that grows all the time
    forces[500:, 2] += 0.02 * gap
    steps = np.ones(600)
    steps[500] += gap
    detector = SlipDetector(SlipDetectorConfig(), 1)
    told = at_stamps(forces, steps, detector)
    assert not (told == SLIP).any()
    assert (told[100:] == STICK).all()
    assert detector.evidence[0] < 1.0
    assert detector._memory["variance"][0] == pytest.approx(6.0 * 0.01**2, rel=0.3)


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 2000.0])
def test_sliding_is_found_within_ten_samples_at_any_rate(rate):
    forces = np.concatenate([sticking(1000), sliding(50)])
    told = at_stamps(forces, np.full(1050, 1e3 / rate))
    assert not (told[:1000] == SLIP).any()
    assert (told[1000:1010] == SLIP).any()


def pulled(late, seed, slides=False):
    """Return what is reported at 500 Hz of a load that rises by 4 N within some 20 ms.

    Args:
        late: Maximum number of ticks by which the hand's answer to it is late, each time at random.
        seed: Of delays and noise.
        slides: Whether it slides from the beginning of the load on.
    """
    random = np.random.default_rng(seed)
    ticks = np.arange(400) - random.integers(1, late, 400, endpoint=True)
    ticks = np.maximum.accumulate(ticks)  # the newest command that has come
    share = 1.0 - np.exp(-np.maximum(ticks - 300, 0) / 10.0)
    forces = np.array([0.5, 8.0, 0.2]) + share[:, None] * [3.2, 0.0, -2.4]
    forces += 0.01 * random.standard_normal((400, 3))
    forces[300:] += slides * 0.15 * random.standard_normal((100, 3))
    return at_stamps(forces, np.full(400, 2.0))


@pytest.mark.parametrize("seed", range(10))
def test_commands_that_are_late_now_and_then_are_no_slip(seed):
    """By 1 to 3 ticks: the force jerks along its own course."""
    assert not (pulled(3, seed) == SLIP).any()


@pytest.mark.parametrize("late", [1, 3])
@pytest.mark.parametrize("seed", range(10))
def test_sliding_is_found_while_the_load_rises(late, seed):
    told = pulled(late, seed, slides=True)
    assert not (told[:300] == SLIP).any()
    assert (told[300:310] == SLIP).any()


@pytest.mark.parametrize("axis", range(3))
def test_a_force_with_a_component_that_is_not_known_is_not_known(axis):
    """And it takes three samples more until a second difference is."""
    detector, ramp = SlipDetector(SlipDetectorConfig(settling_time=0.0), 1), EVEN[:, 0]
    assert (run(ramp[:10], detector)[3:] == STICK).all()
    lost = ramp[10].copy()
    lost[axis] = np.nan
    assert run([lost], detector) == UNKNOWN and not detector.fresh[0]
    np.testing.assert_array_equal(run(ramp[11:20], detector), [UNKNOWN] * 2 + [STICK] * 7)


def ramped(steps, kink=(0.0, 0.0, 0.0)):
    """Return a detector after a force that grows evenly in time, with a kink in its last sample.

    Steps are multiples of 2^-10 s, so that before it no second difference is anything but 0.
    """
    detector, time = SlipDetector(SlipDetectorConfig(noise=1e-6, settling_time=0.0), 1), 0.0
    for i, ticks in enumerate(steps):
        time += ticks / 1024.0
        force = np.array([1.0 + 2.0 * time, 5.0, -time])
        if i == len(steps) - 1:
            assert detector.evidence[0] == 0.0
            force += kink
        detector.step(force[None], NORMAL, 0.0, ticks / 1024.0, np.array([np.inf]))
    return detector


@pytest.mark.parametrize(
    ("before", "last"), [(1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (4.0, 1.0), (2.0, 5.0), (1.5, 3.0)]
)
def test_a_kink_counts_by_how_unevenly_its_samples_came(before, last):
    """Its second difference is the kink itself, of noise that 1 + (1 + q)^2 + q^2 weighs."""
    detector = ramped([1.0, 2.0, 1.0, 1.5, 2.0, before, last], [3.0 * FLOOR[1], 0.0, 0.0])
    q = last / before
    gain = 1.0 + (1.0 + q) ** 2 + q * q
    assert detector.fresh[0]
    expected = max(0.0, evidence(9.0 * 6.0 / gain))
    assert detector.evidence[0] == pytest.approx(expected, rel=1e-6)
    assert detector.agrees[0] == (expected > 0.0)


@pytest.mark.parametrize(("last", "counts"), [(2.5, True), (2.501953125, False)])
def test_a_gap_is_more_than_two_and_a_half_steps(last, counts):
    """After it two more samples are needed; the differences begin with the time between them."""
    steps = [1.0, 1.0, 1.0, 1.0, last]
    kink = [9.0 * FLOOR[1], 0.0, 0.0]
    assert (ramped(steps, kink).evidence[0] > 0.0) == counts == ramped(steps).fresh[0]
    after = ramped([*steps, 1.0], kink)
    assert (after.evidence[0] > 0.0) == counts == after.fresh[0]
    assert ramped([*steps, 1.0, 1.0], kink).evidence[0] == pytest.approx(7.0)


def test_samples_without_a_time_between_them_count_as_even():
    detector = ramped([1.0, 1.0, 1.0, 1.0])
    time = 4.0 / 1024.0
    force = np.array([[1.0 + 2.0 * (time + 1.0 / 1024.0), 5.0, -time - 1.0 / 1024.0]])
    detector.step(force, NORMAL, 0.0, 0.0, np.array([np.inf]))
    assert detector.fresh[0] and detector.evidence[0] == 0.0


@pytest.mark.parametrize("step", [0.01, 0.02, 0.5])
def test_time_counts_for_no_more_than_a_fiftieth_of_a_second_at_once(step):
    """Of the patience, after which what lasts is noise, and of the time to settle."""
    detector, counted = SlipDetector(SlipDetectorConfig(settling_time=0.05), 1), min(step, 0.02)
    told = [detector.step(EVEN[:1, 0], NORMAL, 0.0, step, np.array([9.0]))[0] for _ in range(9)]
    # The first two samples have no second difference; then each counts until 50 ms are over.
    told = at_stamps(EVEN[:12, 0], [1e3 * step] * 12)
    first = int(np.argmax(told == STICK))
    assert first == 2 + int(np.floor(0.05 / counted + 1e-9))


def learned(steps, **values):
    """Return the variance after each of some samples of white noise, and as it should be."""
    config = SlipDetectorConfig(noise=0.01, **values)
    detector, mu = SlipDetector(config, 1), np.array([np.inf])
    forces = sticking(len(steps), 0.01, seed=8)
    variance, touched, found, expected = 6e-4, 0.0, [], []
    for i, (force, dt) in enumerate(zip(forces, steps, strict=True)):
        detector.step(force[None], NORMAL, 0.0, dt, mu)
        if i >= 2:
            touched += dt
            q = dt / steps[i - 1]
            bend = force - forces[i - 1] - q * (forces[i - 1] - forces[i - 2])
            power = 6.0 * (bend[0] ** 2 + bend[2] ** 2) / (1.0 + (1.0 + q) ** 2 + q * q)
            share = min(1.0, dt / max(min(config.learning_time, touched), 10.0 * dt))
            bounded = min(0.5 * power, 3.0 * variance) / (1.0 - np.exp(-3.0))
            variance += share * (bounded - variance)
        found.append(detector._memory["variance"][0])
        expected.append(variance)
    return found, expected


@pytest.mark.parametrize("settling", [0.0, 0.03])
def test_noise_is_learned_quickly_at_first_and_bounded_by_three_times_itself(settling):
    steps = np.tile([0.001, 0.002, 0.0015], 40)
    found, expected = learned(steps, learning_time=0.05, settling_time=settling)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_contact_that_was_lost_settles_again():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    assert run(sticking(200), detector)[-1] == STICK
    run([NOTHING], detector)
    told = run(sticking(100, seed=2), detector)
    assert (told[:50] == UNKNOWN).all() and told[-1] == STICK
