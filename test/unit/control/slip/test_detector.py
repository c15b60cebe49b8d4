# SPDX-License-Identifier: Apache-2.0
"""The slip detector alone, on hand-made forces."""

import numpy as np
import pytest

from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig

UNKNOWN, STICK, SLIP = ContactState.UNKNOWN, ContactState.STICK, ContactState.SLIP
DT, NOTHING = 0.001, [np.nan] * 3


def normals_of(contacts):
    """Return normals along y, as columns of contact frames."""
    return np.tile(np.eye(3), (contacts, 1, 1))[:, :, 1]


NORMAL = normals_of(1)


def run(forces, detector=None, dt=DT, normal=NORMAL, fresh=None):
    """Return the detector's states for the forces of one contact, one per tick."""
    detector = detector or SlipDetector(SlipDetectorConfig(), 1)
    steps = np.broadcast_to(dt, len(forces))
    told = []
    for i, force in enumerate(forces):
        new = np.array([fresh is None or fresh[i]])
        told.append(detector.step(np.array([force]), normal, normal, new, float(steps[i]))[0])
    return np.array(told)


def sticking(ticks, noise=0.01, seed=0):
    random = np.random.default_rng(seed)
    return np.array([1.0, 5.0, 0.5]) + noise * random.standard_normal((ticks, 3))


def sliding(ticks, rms=0.15, seed=1):
    return sticking(ticks, rms, seed)


def slips_once(ticks=500, **how):
    return np.concatenate([sticking(ticks), sliding(20, **how)])


def in_noise(detector, contacts, ticks, freedoms, noise):
    """Yield the states of contacts that stick, tested in two freedoms or the normal force alone."""
    random, normals, new = np.random.default_rng(0), normals_of(contacts), np.ones(contacts, bool)
    axes, kept = (normals, 1.0) if freedoms == 2 else (0.0 * normals, normals)
    for _ in range(ticks):
        forces = np.array([1.0, 5.0, 0.5]) + noise * random.standard_normal((contacts, 3))
        yield detector.step(kept * forces, normals, axes, new, DT, freedoms)


@pytest.mark.parametrize("freedoms", [1, 2])
def test_false_alarms_are_as_rare_as_they_are_asked_to_be(freedoms):
    """A thousand contacts for 1 s, at one accepted alarm per contact and 12 min: 1.4 in total."""
    detector = SlipDetector(SlipDetectorConfig(false_alarm_time=720.0), 1000)
    before, alarms = np.zeros(1000, dtype=int), 0
    for now in in_noise(detector, 1000, 1000, freedoms, 0.01):
        alarms += int(((now == SLIP) & (before != SLIP)).sum())
        before = now
    assert alarms <= 1


@pytest.mark.parametrize("freedoms", [1, 2])
def test_noise_is_learned_without_a_bias(freedoms):
    detector = SlipDetector(SlipDetectorConfig(noise=0.02), 500)
    for _ in in_noise(detector, 500, 4000, freedoms, 0.05):
        pass
    deviation = np.sqrt(detector._memory["variance"].mean())
    assert deviation == pytest.approx(0.05, rel=0.01)


def test_a_skin_that_now_and_then_measures_only_normal_forces_slips_no_more():
    detector = SlipDetector(SlipDetectorConfig(), 3)
    for states in zip(*(in_noise(detector, 3, 500, kind, 0.01) for kind in (1, 2)), strict=True):
        assert not (np.array(states) == SLIP).any()


def test_a_longer_time_between_false_alarms_finds_slip_later():
    quick, slow = (SlipDetectorConfig(false_alarm_time=t) for t in (1.0, 1e9))
    later = []
    for seed in range(5):
        forces = np.concatenate([sticking(200), sliding(100, rms=0.04, seed=seed)])
        found = [(run(forces, SlipDetector(c, 1)) == SLIP).argmax() for c in (quick, slow)]
        assert min(found) >= 200
        later.append(found[1] - found[0])
    assert np.mean(later) > 1.0


def slipping(jerks, pressed, ticks=500):
    """Return which of two contacts slips when jerks, (n, 2, 3), N, follow a grasp that sticks.

    The torques press with `pressed`, shape (ticks + n, 2, 3), N; None: unknown.
    """
    forces = np.stack([sticking(ticks + len(jerks), seed=seed) for seed in (3, 4)], axis=1)
    forces[ticks:] += jerks
    detector, normals, new = SlipDetector(SlipDetectorConfig(), 2), normals_of(2), np.ones(2, bool)
    found = np.zeros(2, bool)
    for i, f in enumerate(forces):
        torques = {} if pressed is None else {"pressed": pressed[i]}
        found |= detector.step(f, normals, normals, new, DT, **torques) == SLIP
    return found.tolist()


def test_what_the_torques_shake_is_no_slip_at_any_contact():
    """The object passes on to the second finger what the torques of the first do."""
    steps = 0.5 * np.random.default_rng(5).standard_normal((40, 3)) * [1.0, 0.0, 1.0]
    jerks, pressed = 0.7 * np.stack([steps, -0.5 * steps], axis=1), np.zeros((540, 2, 3))
    pressed[500:, 0] = steps
    assert slipping(jerks, None) == slipping(jerks, np.full_like(pressed, np.nan)) == [True, True]
    assert slipping(jerks, pressed) == [False, False]
    # Along the internal force they change k_f, which shakes nothing across it.
    assert slipping(jerks, pressed[:, :, [1, 0, 1]]) == [True, True]


@pytest.mark.parametrize("unknown", [[], [100, 300]])
def test_noise_of_measured_torques_hides_no_slip(unknown):
    pressed = np.random.default_rng(6).standard_normal((515, 2, 3))
    pressed[unknown] = np.nan
    jerks = np.zeros((15, 2, 3))
    jerks[:, 1] = 0.3 * np.random.default_rng(7).standard_normal((15, 3))
    assert slipping(jerks, pressed) == [False, True]


@pytest.mark.parametrize("repeats", [False, True])
def test_a_finger_that_has_let_go_or_whose_skin_is_stuck_excuses_no_other(repeats):
    detector, normals = SlipDetector(SlipDetectorConfig(), 2), normals_of(2)
    forces = np.stack([sticking(520, seed=3), slips_once()], axis=1)
    forces[494:, 0], pressed = forces[493, 0] if repeats else np.nan, np.zeros((520, 2, 3))
    pressed[493, 0] = 5.0
    told = [
        detector.step(f, normals, normals, np.array([i < 494, True]), DT, pressed=p)
        for i, (f, p) in enumerate(zip(forces, pressed, strict=True))
    ]
    assert SLIP in np.array(told)[:, 1]


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 2000.0])
def test_sliding_is_found_within_eight_samples_at_any_rate(rate):
    told = run(slips_once(), dt=1.0 / rate)
    assert not (told[:500] == SLIP).any() and (told[500:508] == SLIP).any()


@pytest.mark.parametrize("axis", [[1.0, 2.0, 0.5], [0.0, 0.0, 1.0], [0.0, 1e-3, 0.0]])
def test_what_acts_along_the_internal_force_is_no_slip(axis):
    """However large; a vibration across it of the same size is a slip."""
    axis, random = np.array(axis), np.random.default_rng(3)
    across = np.cross(axis, [0.6, 0.0, 0.8])
    found = []
    for way in (axis, across):
        jerks = random.standard_normal((40, 1)) * way / np.linalg.norm(way)
        forces = sticking(500)
        forces[460:] += jerks
        detector, line = SlipDetector(SlipDetectorConfig(), 1), np.array([axis])
        told = [detector.step(f[None], NORMAL, line, np.array([True]), DT)[0] for f in forces]
        found.append(SLIP in told)
    assert found == [False, True]


@pytest.mark.parametrize("size", [0.5, 3.0, 30.0])
@pytest.mark.parametrize("stays", [True, False])
def test_a_push_is_no_slip(size, stays):
    forces = sticking(1000)
    forces[500 : None if stays else 501, 0] += size
    assert not (run(forces) == SLIP).any()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("slides", [False, True])
def test_commands_that_are_late_now_and_then_are_no_slip_and_hide_none(seed, slides):
    """A load of 4 N within 20 ms at 500 Hz, delayed by 1 to 3 ticks: jitter along its course."""
    random = np.random.default_rng(seed)
    ticks = np.maximum.accumulate(np.arange(400) - random.integers(1, 3, 400, endpoint=True))
    course = 1.0 - np.exp(-np.maximum(ticks - 300, 0) / 10.0)
    forces = np.array([0.5, 8.0, 0.2]) + course[:, None] * [3.2, 0.0, -2.4]
    forces += 0.01 * random.standard_normal((400, 3))
    forces[300:] += slides * 0.15 * random.standard_normal((100, 3))
    told = run(forces, dt=0.002)
    assert not (told[:300] == SLIP).any() and (told[300:310] == SLIP).any() == slides


@pytest.mark.parametrize("gap", [1, 2, 7, 50])
def test_a_gap_is_no_slip_whatever_the_load_did_in_it(gap):
    forces = sticking(600)
    forces[:, 2] += 0.02 * np.arange(600)
    forces[500:] += [3.0, 0.0, 0.02 * gap]
    steps = np.full(600, DT)
    steps[500] += DT * gap
    told = run(forces, dt=steps)
    assert (told[100:] == STICK).all()


def test_a_repeated_sample_counts_for_nothing():
    """A 250 Hz skin with 1 kHz ticks is judged like one with single samples."""
    samples = slips_once()
    slow = run(np.repeat(samples, 4, axis=0), fresh=np.tile([1, 0, 0, 0], len(samples)) > 0)
    alone = run(samples, dt=4 * DT)
    np.testing.assert_array_equal(slow[::4][100:], alone[100:])


def test_a_slip_expires_with_the_samples_that_showed_it():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    assert run(slips_once(), detector)[-1] == SLIP
    frozen = run([sliding(20)[-1]] * 100, detector, fresh=np.zeros(100, bool))
    assert (frozen[6:] != SLIP).all()
    assert not detector.agrees[0] and not detector.likelihood[0]


def test_the_newest_sample_shows_the_end_sooner_than_the_sum():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    run(slips_once(), detector)
    run(sticking(2, seed=9), detector)
    run(sticking(1, seed=9)[[0, 0]], detector)
    assert not detector.agrees[0]
    assert run(sticking(40, seed=9), detector)[-1] == STICK


def test_what_lasts_is_learned_as_noise_and_short_slips_are_not():
    detector = SlipDetector(SlipDetectorConfig(), 1)
    for i in range(5):
        run(sticking(300, seed=i), detector)
        assert np.mean(run(sliding(100, rms=0.05, seed=50 + i), detector) == SLIP) > 0.85
    told = run(sliding(8000, rms=0.05), detector)
    assert (told[:300] == SLIP).any() and not (told[-1000:] == SLIP).any()


@pytest.mark.parametrize("values", [{"minimum_noise": 0.1}, {"relative_noise": 0.02}])
def test_vibration_below_the_minimum_noise_is_never_slip(values):
    forces = slips_once(rms=0.06)
    assert (run(forces) == SLIP).any()
    assert not (run(forces, SlipDetector(SlipDetectorConfig(**values), 1)) == SLIP).any()


@pytest.mark.parametrize("axis", range(3))
def test_a_contact_that_was_lost_is_unknown_until_it_has_settled_again(axis):
    detector = SlipDetector(SlipDetectorConfig(), 1)
    assert run(sticking(200), detector)[-1] == STICK
    lost = sticking(1)
    lost[0, axis] = np.nan
    assert run(lost, detector) == UNKNOWN
    told = run(sticking(100, seed=2), detector)
    assert (told[:49] == UNKNOWN).all() and (told[52:] == STICK).all()


def test_a_force_that_is_no_more_than_noise_is_unknown():
    """Half of the samples around three standard deviations are."""
    weak = sticking(1500) - [0.9, 5.0, 0.5]
    known = [np.mean(run(weak + [0.0, 0.01 * n, 0.0])[500:] == STICK) for n in (1.0, 3.0, 20.0)]
    assert known == [pytest.approx(0.0, abs=0.05), pytest.approx(0.5, abs=0.1), 1.0]


def test_contacts_are_judged_apart():
    detector, new = SlipDetector(SlipDetectorConfig(), 3), np.ones(3, bool)
    normals = normals_of(3)
    quiet, loud = sticking(520), slips_once()
    for i in range(520):
        forces = np.array([quiet[i], loud[i], NOTHING])
        state = detector.step(forces, normals, normals, new, DT)
    np.testing.assert_array_equal(state, [STICK, SLIP, UNKNOWN])
