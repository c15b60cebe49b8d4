# SPDX-License-Identifier: Apache-2.0
"""Friction of a contact: learned from real slips and sticks, recovered from false alarms."""

import numpy as np
import pytest

from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.friction import FrictionConfig, FrictionEstimator

DT = 0.001


def feel(
    estimator,
    ratios,
    state,
    evidence,
    contact=0,
    agrees=True,
    fresh=True,
    normal=5.0,
    noise=0.01,
    seed=0,
):
    """Feed force ratios to one contact, one a tick, and return its last estimate."""
    random = np.random.default_rng(seed)
    k = len(estimator.estimate)
    told = np.full(k, state), np.full(k, evidence), DT, np.full(k, agrees), np.full(k, fresh)
    forces = np.full((k, 3), np.nan)
    for ratio in ratios:
        forces[contact] = np.array([ratio * normal, normal, 0.0]) + noise * random.standard_normal(
            3
        )
        estimator.step(forces, *told)
    return estimator.estimate[contact]


def slip(estimator, ratio, **how):
    """Let a contact slide for 12 ms, of which the first 5 are only suspected."""
    feel(estimator, [ratio] * 5, ContactState.STICK, 10.0, **how)
    return feel(estimator, [ratio] * 7, ContactState.SLIP, 22.0, **how)


def quiet(estimator, seconds, ratio=0.1, **how):
    return feel(estimator, [ratio] * round(seconds / DT), ContactState.STICK, 0.0, **how)


def still(contacts=1, **values):
    """Return an estimator that does not grow."""
    return FrictionEstimator(FrictionConfig(explore=0.0, forget=0.0, **values), contacts)


def test_without_contact_nothing_is_learned():
    estimator = still()
    for state, ratio in ((ContactState.UNKNOWN, 1.0), (ContactState.STICK, np.nan)):
        feel(estimator, [ratio] * 200, state, 0.0)
    assert estimator.estimate == 0.4


def test_what_sticks_again_says_nothing_of_friction():
    """The grasp force catches it for a while in the middle; the detector still says slip."""
    plain, caught = still(), still()
    feel(plain, [0.3] * 6, ContactState.SLIP, 22.0, noise=0.0)
    feel(caught, [0.3] * 3, ContactState.SLIP, 22.0, noise=0.0)
    feel(caught, [0.05] * 10, ContactState.SLIP, 22.0, noise=0.0, agrees=False)
    assert caught.estimate == 0.4 and caught.confidence == 0.0  # three samples are too few
    feel(caught, [0.3] * 3, ContactState.SLIP, 22.0, noise=0.0)
    assert caught.estimate == plain.estimate < 0.35 and caught.confidence == plain.confidence > 0.5


def test_an_estimate_stays_within_its_limits_and_reaches_them():
    low, high = still(least=0.15, prior=0.2), still(most=0.9)
    for _ in range(4):
        slip(low, 0.01)
        quiet(low, 0.1, ratio=0.0)
    assert low.estimate == 0.15
    assert quiet(high, 0.5, ratio=0.85) == pytest.approx(0.85, abs=0.01)
    assert quiet(high, 0.5, ratio=1.4) == 0.9
    growing = FrictionEstimator(FrictionConfig(explore=2.0, most=0.6), 1)
    assert quiet(growing, 0.1) < 0.6 == quiet(growing, 1.0)


def test_each_contact_learns_from_its_own_forces():
    hand = still(contacts=3)
    slip(hand, 0.2, contact=1)
    quiet(hand, 0.5, ratio=0.7, contact=2)
    assert hand.estimate[0] == 0.4 and hand.confidence[0] == hand.confidence[2] == 0.0
    assert hand.estimate[1] == pytest.approx(0.2, abs=0.03) and hand.confidence[1] > 0.5
    assert hand.estimate[2] == pytest.approx(0.7, abs=0.01)
    hand.reset()
    assert (hand.estimate == 0.4).all() and not hand.confidence.any()


def test_each_contact_learns_only_while_its_own_samples_tell_of_slip():
    hand, forces = still(contacts=3), np.array([[1.0, 5.0, 0.0], [0.5, 5.0, 0.0], [0.2, 2.0, 0.0]])
    for _ in range(6):
        hand.step(
            forces,
            np.full(3, ContactState.SLIP),
            np.full(3, 22.0),
            DT,
            np.array([False, True, False]),
            np.full(3, True),
        )
    assert hand.estimate[1] < 0.2 < 0.5 < hand.confidence[1]
    np.testing.assert_array_equal(hand.estimate[[0, 2]], 0.4)


def test_a_neighbour_is_believed_half_and_only_by_one_that_knows_less_than_that():
    hand = still(contacts=4)
    for contact, ratio, how in ((3, 0.2, {}), (0, 0.6, {"noise": 0.5}), (2, 0.6, {"noise": 1.3})):
        slip(hand, ratio, contact=contact, **how)
    before, sure = hand.estimate, hand.confidence
    half = 0.5 * sure[3]
    assert sure[1] == 0.0 < sure[2] < half < sure[0] < sure[3] and before[3] < before[[0, 2]].min()
    hand.share()
    share = sure[3] * (1.0 - sure[[1, 2]])
    expected = before[[1, 2]] + share * (before[3] - before[[1, 2]])
    np.testing.assert_allclose(hand.estimate[[1, 2]], expected)
    np.testing.assert_allclose(hand.confidence, [sure[0], half, half, sure[3]])
    np.testing.assert_array_equal(hand.estimate[[0, 3]], before[[0, 3]])


def test_a_sample_that_is_repeated_is_learned_from_once():
    """A slow skin repeats each sample; one alone is no reading of a slip."""
    estimator = still()
    assert slip(estimator, 0.2, fresh=False) == pytest.approx(0.4)
    assert estimator.confidence[0] == 0.0
    assert quiet(estimator, 0.5, ratio=0.9, fresh=False) == pytest.approx(0.4)
