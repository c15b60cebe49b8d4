# SPDX-License-Identifier: Apache-2.0
"""Friction from slips and sticks, number by number: what each reading weighs, what is forgotten."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.friction import FrictionConfig, FrictionEstimator

UNKNOWN, STICK, SLIP = ContactState.UNKNOWN, ContactState.STICK, ContactState.SLIP
PRIOR, TRUST = 0.4, 0.05
BRIEF = 1.0 / 1024.0  # s, and all its multiples are exact
SLIDE = np.array([[1.1, 4.9, 0.5]])  # some force that slides
RATIO = np.hypot(1.1, 0.5) / 4.9


def still(contacts=1, **values):
    """Return an estimator that does not grow."""
    return FrictionEstimator(FrictionConfig(explore=0.0, forget=0.0, **values), contacts)


def step(estimator, force, state=SLIP, evidence=22.0, dt=BRIEF, agrees=True, fresh=True):
    """Let every contact feel a force; return what is known of the first: friction, confidence."""
    k = len(estimator.estimate)
    told = np.full(k, state), np.full(k, evidence), dt, np.full(k, agrees), np.full(k, fresh)
    estimator.step(np.broadcast_to(np.asarray(force, dtype=float), (k, 3)), *told)
    return estimator.estimate[0], estimator.confidence[0]


def slide(estimator, forces, **how):
    for force in forces:
        found = step(estimator, force, **how)
    return found


def quiet(estimator, ticks, force=(0.0, 5.0, 0.0), dt=BRIEF, **how):
    for _ in range(ticks):
        found = step(estimator, force, STICK, 0.0, dt, **how)
    return found


def read(forces):
    """Return the ratio that a slip shows and its weight: means of four, the three largest."""
    means = sliding_window_view(np.asarray(forces), 4, axis=0)[:10]
    mean = means.mean(axis=-1)
    ratios = np.hypot(mean[:, 0], mean[:, 2]) / mean[:, 1]
    variances = means.var(axis=-1, ddof=1).mean(axis=1) / 4.0 / mean[:, 1] ** 2 + 1e-4
    information = TRUST**2 * (1.0 / (4.0 * variances)).sum()
    return np.sort(ratios)[-3:].mean(), information / (1.0 + information)


@pytest.mark.parametrize("ticks", range(1, 17))
def test_every_mean_of_four_forces_counts_up_to_the_tenth(ticks):
    ratio, weight = read(np.repeat(SLIDE, ticks, axis=0)) if ticks > 3 else (RATIO, 0.0)
    estimate, confidence = slide(still(), np.repeat(SLIDE, ticks, axis=0))
    assert weight == pytest.approx(
        0.0 if ticks < 4 else 1.0 - 1.0 / (1.0 + 6.25 * min(ticks - 3, 10))
    )
    assert estimate == pytest.approx(PRIOR + weight * (ratio - PRIOR), rel=1e-12)
    assert confidence == pytest.approx(weight, rel=1e-12)


@pytest.mark.parametrize("ticks", [4, 5, 6, 7, 9, 12, 13, 14, 16])
def test_the_largest_three_ratios_count_by_what_they_vary(ticks):
    random = np.random.default_rng(3)
    forces = SLIDE + np.linspace(0.3, -0.4, 16)[:, None] * [1.0, 0.2, 0.5]
    forces = (forces + 0.2 * random.standard_normal((16, 3)))[:ticks]
    ratio, weight = read(forces)
    estimate, confidence = slide(still(), forces)
    assert estimate == pytest.approx(PRIOR + weight * (ratio - PRIOR), rel=1e-12)
    assert confidence == pytest.approx(weight, rel=1e-12)


def test_a_mean_that_does_not_press_shows_nothing():
    pulling = np.array([1.0, -4.0, 0.5])
    assert slide(still(), [pulling, -pulling] * 4) == (PRIOR, 0.0)
    once = slide(still(), [pulling, *[[1.0, 4.0, 0.5]] * 4])
    assert once == pytest.approx(slide(still(), [[1.0, 4.0, 0.5]] * 4), rel=0.5)
    assert once[1] > 0.0


@pytest.mark.parametrize("off", [-0.151, -0.149, 0.149, 0.151])
def test_a_slip_that_agrees_makes_sure_and_another_does_not(off):
    estimator = still()
    slide(estimator, [[PRIOR * 5.0, 5.0, 0.0]] * 5)
    quiet(estimator, 100)
    before, sure = estimator.estimate[0], estimator.confidence[0]
    assert before == pytest.approx(PRIOR) and sure == pytest.approx(12.5 / 13.5)
    ratio = (1.0 + off) * before
    weight, shown, known = 6.25 / 7.25, 6.25, sure / (1.0 - sure)
    gain = shown / (1.0 + 2.0 * known + shown)
    estimate, confidence = slide(estimator, [[0.0, 5.0, ratio * 5.0]] * 4)
    assert estimate == pytest.approx(before + gain * (ratio - before), rel=1e-12)
    expected = 1.0 - (1.0 - sure) * (1.0 - weight) if abs(off) < 0.15 else gain
    assert confidence == pytest.approx(expected, rel=1e-12)


def test_a_weak_contrary_slip_shakes_what_is_known_by_its_weight():
    estimator = still()
    slide(estimator, [[PRIOR * 5.0, 5.0, 0.0]] * 12)
    quiet(estimator, 100)
    sure = estimator.confidence[0]
    forces = np.array([[0.5, 5.0, 0.0]]) + 1.5 * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    _, weight = read(forces)
    known, shown = sure / (1.0 - sure), weight / (1.0 - weight)
    assert shown / (1.0 + 2.0 * known + shown) < sure * (1.0 - weight)
    _, confidence = slide(estimator, forces)
    assert confidence == pytest.approx(sure * (1.0 - weight), rel=1e-12)


@pytest.mark.parametrize("ticks", [4, 5, 6])
def test_what_comes_within_a_twentieth_of_a_second_is_the_same_slip(ticks):
    """It then weighs against what was known before the first alarm, not after it."""
    estimator = still()
    slide(estimator, np.repeat(SLIDE, 6, axis=0))
    first, sure = estimator.estimate[0], estimator.confidence[0]
    quiet(estimator, ticks, dt=0.0125)  # four of them are 50 ms, to the bit
    found = slide(estimator, [[0.0, 5.0, 1.0]] * 4)[0]
    # Three readings of the first alarm are the largest until a quiet tick follows its end.
    ratio, shown = (0.2, 6.25) if ticks == 6 else (RATIO, 25.0)
    before, known = (PRIOR, 0.0) if ticks == 4 else (first, sure / (1.0 - sure))
    expected = before + shown / (1.0 + 2.0 * known + shown) * (ratio - before)
    assert found == pytest.approx(expected, rel=1e-12)


def test_a_contact_that_was_lost_begins_a_slip_of_its_own():
    estimator = still()
    slide(estimator, np.repeat(SLIDE, 6, axis=0))
    estimate, sure = estimator.estimate[0], estimator.confidence[0]
    step(estimator, np.full(3, np.nan), STICK, 0.0)
    assert (estimator.estimate[0], estimator.confidence[0]) == (estimate, sure)
    assert slide(estimator, [[0.0, 5.0, 1.0]] * 3, evidence=22.0)[0] == estimate
    known = sure / (1.0 - sure)
    expected = estimate + 6.25 / (7.25 + 2.0 * known) * (0.2 - estimate)
    assert step(estimator, [0.0, 5.0, 1.0])[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("lost", ["the force", "the state"])
def test_forces_from_before_a_loss_do_not_count(lost):
    estimator = still()
    slide(estimator, np.repeat(SLIDE, 3, axis=0))
    nothing = [np.nan, 5.0, 0.0] if lost == "the force" else SLIDE[0]
    step(estimator, nothing, STICK if lost == "the force" else UNKNOWN)
    assert slide(estimator, np.repeat(SLIDE, 3, axis=0)) == (PRIOR, 0.0)
    assert step(estimator, SLIDE[0])[1] == pytest.approx(6.25 / 7.25)


def test_suspicion_counts_as_soon_as_the_alarm_confirms_it_and_is_dropped_otherwise():
    plain, suspected, dropped = still(), still(), still()
    for estimator in (suspected, dropped):
        slide(estimator, np.repeat(SLIDE, 6, axis=0), state=STICK, evidence=5.0)
        assert estimator.confidence[0] == 0.0
    assert step(suspected, SLIDE[0]) == slide(plain, np.repeat(SLIDE, 7, axis=0))
    quiet(dropped, 1)
    assert slide(dropped, np.repeat(SLIDE, 3, axis=0))[1] == 0.0
    assert step(dropped, SLIDE[0])[1] == pytest.approx(6.25 / 7.25)


@pytest.mark.parametrize(("dt", "counts"), [(0.01, 0.01), (0.02, 0.02), (0.5, 0.02)])
def test_an_estimate_grows_by_what_is_known_of_it_and_over_no_pause(dt, counts):
    estimator = FrictionEstimator(FrictionConfig(explore=0.3, forget=0.02), 1)
    assert quiet(estimator, 1, dt=dt)[0] == pytest.approx(PRIOR * (1.0 + 0.3 * counts), rel=1e-12)
    before, sure = slide(estimator, np.repeat(SLIDE, 5, axis=0))
    growth = 0.3 + sure * (0.02 - 0.3)
    after = quiet(estimator, 1, dt=dt)[0]
    assert after == pytest.approx(before * (1.0 + growth * counts), rel=1e-12)


def test_a_neighbour_that_is_as_low_tells_nothing():
    hand = FrictionEstimator(FrictionConfig(prior=0.5, explore=0.3, forget=0.0), 2)
    both = np.array([[2.5, 5.0, 0.0], [np.nan] * 3])
    for _ in range(6):
        told = np.full(2, SLIP), np.full(2, 22.0), BRIEF, np.full(2, True), np.full(2, True)
        hand.step(both, *told)
    assert (hand.estimate == 0.5).all() and hand.confidence[0] > 0.9
    hand.share()
    assert hand.confidence[1] == 0.0
    told = np.full(2, STICK), np.zeros(2), BRIEF, np.full(2, True), np.full(2, True)
    hand.step(both[::-1], *told)
    assert hand.estimate[1] == pytest.approx(0.5 * (1.0 + 0.3 * BRIEF), rel=1e-12)


def test_a_contact_is_cautious_only_while_a_better_known_one_is_lower():
    hand = FrictionEstimator(FrictionConfig(explore=0.3, forget=0.0), 2)
    for other, sure in ((0.3, 0.9), (0.6, 0.5)):  # lower, then higher than the second contact
        memory = hand.memory
        memory["estimate"], memory["confidence"] = [other, 0.5], [0.9, 0.5]
        hand.restore(memory)
        hand.share()
        told = np.full(2, STICK), np.zeros(2), BRIEF, np.full(2, True), np.full(2, True)
        hand.step(np.array([[0.0, 5.0, 0.0]] * 2), *told)
        expected = 0.5 * (1.0 + 0.3 * (1.0 - sure) * BRIEF)
        assert hand.estimate[1] == pytest.approx(expected, rel=1e-12)


def test_sticking_proves_a_ratio_once_three_time_constants_have_passed():
    """Smoothing of 8 ticks: the first sample starts it, and 24 more are 3 of them to the bit."""
    estimator = still(smoothing=8.0 * BRIEF)
    assert quiet(estimator, 24, (3.0, 5.0, -1.5))[0] == PRIOR
    expected = np.hypot(3.0, 1.5) / 5.0
    assert quiet(estimator, 1, (3.0, 5.0, -1.5))[0] == pytest.approx(expected, rel=1e-12)


def proven(forces, steps, smoothing):
    """Return the ratio that is proven at each step: two standard deviations on the safe side."""
    mean, variance, found = forces[0], 0.0, [0.0]
    for force, dt in zip(forces[1:], steps[1:], strict=True):
        share = 1.0 - np.exp(-dt / smoothing)
        off = force - mean
        mean = mean + share * off
        variance += share * (off @ off / 3.0 - variance)
        doubt = 2.0 * np.sqrt(variance * share)
        found.append(max(0.0, np.hypot(mean[0], mean[2]) - doubt) / (mean[1] + doubt))
    return np.array(found)


def test_a_ratio_is_proven_by_two_standard_deviations():
    random = np.random.default_rng(5)
    forces = np.array([3.0, 5.0, -1.5]) + 0.4 * random.standard_normal((60, 3))
    steps = BRIEF * random.integers(1, 4, 60)
    estimator = still(smoothing=8.0 * BRIEF, least=0.1, prior=0.1, most=9.0)
    known = proven(forces, steps, 8.0 * BRIEF)
    for i, (force, dt) in enumerate(zip(forces, steps, strict=True)):
        found = quiet(estimator, 1, force, dt)[0]
        late = steps[1 : i + 1].sum() >= 24.0 * BRIEF
        certain = known[: i + 1][np.cumsum(steps[: i + 1]) - steps[0] >= 24.0 * BRIEF]
        expected = max(0.1, certain.max()) if late else 0.1
        assert found == pytest.approx(expected, rel=1e-12)
    assert found > 0.3


def test_a_sample_that_is_repeated_counts_for_the_time_until_the_next():
    often, rarely = (still(smoothing=8.0 * BRIEF, prior=0.1) for _ in range(2))
    random = np.random.default_rng(6)
    for force in np.array([3.0, 5.0, -1.5]) + 0.4 * random.standard_normal((20, 3)):
        quiet(often, 2, force, fresh=False)
        found = quiet(often, 1, force)
        assert found == quiet(rarely, 1, force, 3.0 * BRIEF)
    assert found[0] > 0.3


def test_after_a_pause_a_contact_has_not_been_touched_for_longer_than_was_seen():
    estimator = still(smoothing=0.02)
    quiet(estimator, 1, (3.0, 5.0, 0.0))
    assert quiet(estimator, 2, (3.0, 5.0, 0.0), dt=1.0)[0] == PRIOR  # 20 ms each
    assert quiet(estimator, 1, (3.0, 5.0, 0.0), dt=1.0)[0] == pytest.approx(0.6)


def test_after_a_slip_what_was_felt_before_it_proves_nothing():
    estimator = still(smoothing=8.0 * BRIEF)
    quiet(estimator, 20, (3.0, 5.0, 0.0))
    slide(estimator, [[0.5, 5.0, 0.0]] * 4)
    low = estimator.estimate[0]
    assert quiet(estimator, 24, (3.0, 5.0, 0.0))[0] == low < 0.2
    assert quiet(estimator, 1, (3.0, 5.0, 0.0))[0] == pytest.approx(0.6)
    pulled = still(smoothing=8.0 * BRIEF)
    assert quiet(pulled, 60, (3.0, -5.0, 0.0))[0] == PRIOR
    assert quiet(pulled, 60, (3.0, 0.0, 0.0))[0] == PRIOR
