# SPDX-License-Identifier: Apache-2.0
"""The slip detector alone, on forces made by hand."""

import numpy as np
import pytest

from tactile_hand_ros.core.slip_detector import Grip, SlipDetector, SlipDetectorConfig

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
    assert (told[100:] == Grip.STICK).all()


@pytest.mark.parametrize("seed", range(10))
def test_sliding_is_found_within_ten_samples(seed):
    told = run(np.concatenate([sticking(500, seed=seed), sliding(50, seed=100 + seed)]))
    assert not (told[:500] == Grip.SLIP).any()
    assert (told[500:510] == Grip.SLIP).any()


def test_a_push_is_no_slip():
    """The load jumps by 3 N within one sample and stays."""
    forces = sticking(1000)
    forces[500:, 0] += 3.0
    assert not (run(forces) == Grip.SLIP).any()


def test_what_the_hand_does_itself_is_no_slip():
    """The squeeze rises along the normal with jerks that would be slip across it."""
    forces = sticking(1000)
    forces[500:, 1] += 0.5 * np.random.default_rng(3).standard_normal(500)
    assert not (run(forces) == Grip.SLIP).any()


def test_unknown_is_not_no_slip():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    light = sticking(100) * 1e-3
    assert (run(light, detector) == Grip.UNKNOWN).all()
    assert (run([NOTHING] * 10, detector) == Grip.UNKNOWN).all()
    told = run(sticking(100), detector)
    assert (told[:50] == Grip.UNKNOWN).all() and told[-1] == Grip.STICK


def test_repeated_samples_tell_nothing():
    """A skin at 250 Hz under a loop at 1 kHz."""
    forces = np.repeat(sticking(500), 4, axis=0)
    assert not (run(forces) == Grip.SLIP).any()


def test_a_slow_skin_is_judged_by_its_samples_not_by_ticks():
    """One at 250 Hz under a loop at 1 kHz needs as many samples as one that is as slow as it."""
    samples = np.concatenate([sticking(300), sliding(20)])
    slow, fast = run(np.repeat(samples, 4, axis=0)), run(samples)
    assert 300 < (fast == Grip.SLIP).argmax() < 308
    later = (slow == Grip.SLIP).argmax() // 4 - (fast == Grip.SLIP).argmax()
    assert later in (0, 1)


def test_one_wild_sample_of_a_slow_skin_is_no_slip():
    samples = sticking(500)
    samples[300, 0] += 0.5
    assert not (run(np.repeat(samples, 4, axis=0), friction=0.1) == Grip.SLIP).any()


def test_at_the_brink_of_the_believed_cone_slip_is_found_a_sample_earlier():
    """The forces are the same: a ratio of 0.22, against a friction of 0.2 or of 0.9."""
    forces = np.concatenate([sticking(500), sliding(50)])
    first = [int((run(forces, friction=mu) == Grip.SLIP).argmax()) for mu in (0.2, 0.9)]
    assert 503 <= first[0] == first[1] - 1


def test_even_at_the_brink_a_push_is_no_slip():
    forces = sticking(1000)
    forces[500:, 0] += 3.0
    assert not (run(forces, friction=0.2) == Grip.SLIP).any()


def test_the_newest_sample_tells_sooner_than_the_sum_that_it_has_stopped():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    run(np.concatenate([sticking(500), sliding(20)]), detector)
    assert detector.state == [Grip.SLIP]
    run(sticking(4, seed=9), detector)
    assert detector.state == [Grip.SLIP] and not detector.agrees[0]


def test_what_lasts_is_learned_as_noise():
    told = run(np.concatenate([sticking(500), sliding(8000, rms=0.05)]))
    assert (told[500:800] == Grip.SLIP).any() and not (told[-1000:] == Grip.SLIP).any()
