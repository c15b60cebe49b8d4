# SPDX-License-Identifier: Apache-2.0
"""The friction estimate is learned only from slips and sticking contacts."""

import itertools
import math

import numpy as np
import pytest

from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.friction import FrictionConfig, FrictionEstimator

UNKNOWN, STICK, SLIP = ContactState.UNKNOWN, ContactState.STICK, ContactState.SLIP
DT, PRIOR = 0.001, 0.4


def estimator(contacts=3, explore=0.0, **values):
    return FrictionEstimator(FrictionConfig(explore=explore, **values), contacts)


def feel(made, ratios, states, ticks=1, normal=5.0, noise=0.01, seed=0, dt=DT, **told):
    """Feed force ratios and states of all contacts for some ticks; return the estimates."""
    random, k = np.random.default_rng(seed), len(ratios)
    normals = np.tile(np.eye(3), (k, 1, 1))[:, :, 1]  # columns of frames, as contacts have them
    states = np.array(states)
    told = {"suspected": states == SLIP, "agrees": states == SLIP, "fresh": True} | told
    flags = [np.full(k, flag, dtype=bool) for flag in told.values()]
    for _ in range(ticks):
        forces = normal * np.array([[r * 0.6, 1.0, r * 0.8] for r in ratios])
        forces += noise * random.standard_normal((k, 3))
        made.step(forces, normals, states, *flags, dt)
    return made.estimate


def slip(made, ratios, who, **how):
    """Let some contacts slide for 12 ms, of which the first 5 are only suspected."""
    sliding = np.array([i in who for i in range(len(ratios))])
    feel(made, ratios, [STICK] * len(ratios), 5, suspected=sliding, agrees=sliding, **how)
    return feel(made, ratios, np.where(sliding, SLIP, STICK), 7, **how)


def deviation(made):
    """Return the standard deviation of ln mu of each contact."""
    return np.sqrt(made.memory["variance"])


def rest(made, seconds, ratio=0.1, contacts=3):
    return feel(made, [ratio] * contacts, [STICK] * contacts, round(seconds / DT))


def test_what_is_not_known_is_explored_within_one_deviation():
    made = estimator(explore=0.05)
    feel(made, [0.2] * 3, [STICK] * 3, 100, dt=0.02)
    np.testing.assert_allclose(made.estimate, PRIOR * math.exp(0.1))
    feel(made, [0.2] * 3, [STICK] * 3, 500, dt=0.02)
    np.testing.assert_allclose(made.estimate, PRIOR * math.exp(0.5))
    feel(made, [0.2] * 3, [UNKNOWN] * 3, 500, dt=0.02)
    np.testing.assert_allclose(made.estimate, PRIOR * math.exp(0.5))


def test_after_a_slip_it_is_explored_as_it_becomes_uncertain():
    """Initially a tenth as fast, and a false alarm is forgotten within minutes, not seconds."""
    made = estimator(explore=0.05, forget=300.0)
    shown = slip(made, [0.15] * 3, [0, 1, 2])
    feel(made, [0.05] * 3, [STICK] * 3, 500, dt=0.02)
    assert (made.estimate < 1.05 * shown).all()
    feel(made, [0.05] * 3, [STICK] * 3, 3500, dt=0.02)
    assert ((1.4 * shown < made.estimate) & (made.estimate < PRIOR)).all()
    feel(made, [0.05] * 3, [STICK] * 3, 9000, dt=0.02)
    np.testing.assert_allclose(made.estimate, PRIOR * math.exp(0.5), rtol=1e-3)


def test_after_a_false_slip_without_friction_it_is_explored_from_the_smallest_estimate():
    made = estimator(explore=0.05)
    np.testing.assert_allclose(slip(made, [0.02] * 3, [0, 1, 2]), 0.1)
    feel(made, [0.02] * 3, [STICK] * 3, 500, dt=0.02)
    assert (made.estimate > 0.1001).all()


def test_nothing_is_learned_while_nothing_slips():
    """The mean stays forever, and the variance is that of the prior."""
    made = estimator()
    feel(made, [0.2] * 3, [STICK] * 3, 500, dt=10.0)
    np.testing.assert_array_equal(made.estimate, PRIOR)
    np.testing.assert_allclose(deviation(made), 0.5)
    feel(made, [math.nan] * 3, [UNKNOWN] * 3, 50)
    np.testing.assert_array_equal(made.estimate, PRIOR)


@pytest.mark.parametrize("ratio", [0.15, 0.3, 0.4, 0.6, 1.0])
def test_a_slip_shows_the_friction_of_its_finger(ratio):
    made = estimator()
    assert slip(made, [ratio] * 3, [1])[1] == pytest.approx(ratio, rel=0.1)
    assert deviation(made)[1] < 0.12


def test_the_others_learn_less_and_the_same():
    made = estimator()
    found = slip(made, [0.2, 0.2, 0.2], [1])
    assert 0.2 < found[1] < found[0] < 0.3
    assert found[0] == pytest.approx(found[2], rel=1e-12)
    assert deviation(made)[1] < deviation(made)[0] < 0.5


def test_a_contact_that_barely_presses_shows_next_to_nothing():
    found = slip(estimator(), [0.1] * 3, [0], normal=0.05, noise=0.03)
    assert (found > 0.25).all()


def test_slips_of_several_fingers_are_a_product_in_any_order():
    ratios, found = np.array([0.3, 0.2, 0.5]), []
    for order in itertools.permutations(range(3)):
        made = estimator()
        estimate = slip(made, ratios[list(order)], [order.index(0), order.index(1)], noise=0.0)
        found.append([[x[order.index(i)] for i in range(3)] for x in (estimate, deviation(made))])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (6, 2, 3)), rtol=1e-12)


def test_what_slips_have_shown_often_a_single_contrary_one_changes_less():
    once, often = estimator(), estimator()
    for i in range(6):
        slip(often, [0.6] * 3, [0, 1, 2], seed=i)
        rest(often, 0.2)
    slip(once, [0.6] * 3, [0, 1, 2])
    rest(once, 0.2)
    assert deviation(often).max() < 0.5 * deviation(once).min()
    changed = [slip(made, [0.48] * 3, [0])[0] for made in (once, often)]
    assert 0.48 < changed[0] < changed[1] < 0.6


def test_a_surface_that_has_changed_is_learned_however_well_the_old_one_was_known():
    """Water: from 0.6 to 0.15."""
    made = estimator()
    for i in range(6):
        slip(made, [0.6] * 3, [0, 1, 2], seed=i)
        rest(made, 0.2)
    assert (slip(made, [0.15] * 3, [0, 1]) < 0.22).all()


def test_what_was_learned_becomes_uncertain_and_keeps_its_value():
    made = estimator(forget=300.0)
    before, sure = slip(made, [0.2] * 3, [0]), deviation(made)
    feel(made, [0.05] * 3, [STICK] * 3, 300, dt=0.5)
    np.testing.assert_allclose(made.estimate, before)
    np.testing.assert_allclose(deviation(made) ** 2, np.minimum(sure**2 + 0.125, 0.25), rtol=1e-3)
    feel(made, [0.05] * 3, [STICK] * 3, 1000, dt=1.0)
    np.testing.assert_allclose(deviation(made), 0.5)


@pytest.mark.parametrize(("ratio", "expected"), [(0.3, PRIOR), (0.7, 0.7), (2.0, 1.5)])
def test_sticking_at_a_force_ratio_proves_a_friction_above_it(ratio, expected):
    found = rest(estimator(), 0.5, ratio)
    np.testing.assert_allclose(found, expected, rtol=0.01)
    assert (found <= max(ratio, PRIOR)).all()


def test_noise_and_a_single_wild_sample_prove_nothing():
    made = estimator()
    feel(made, [0.3] * 3, [STICK] * 3, 2000, normal=0.2, noise=0.05)
    rest(made, 0.3, 0.3)
    feel(made, [3.0] * 3, [STICK] * 3)
    rest(made, 0.3, 0.3)
    np.testing.assert_array_equal(made.estimate, PRIOR)


def test_a_contact_that_the_grasp_force_has_caught_shows_nothing_more():
    """The detector still reports slip, but its newest samples do not show it."""
    plain, caught = estimator(), estimator()
    for made in (plain, caught):
        slip(made, [0.3] * 3, [0], noise=0.0)
    feel(caught, [0.05] * 3, [SLIP, STICK, STICK], 10, agrees=False, noise=0.0)
    np.testing.assert_allclose(caught.estimate, plain.estimate, rtol=1e-3)


def test_alarms_soon_after_each_other_are_one_slip():
    made = estimator()
    first, sure = slip(made, [0.3] * 3, [0]), deviation(made)
    rest(made, 0.02)
    again = slip(made, [0.3] * 3, [0])
    np.testing.assert_allclose(again, first, rtol=0.03)
    np.testing.assert_allclose(deviation(made), sure, rtol=0.1)


def test_a_repeated_sample_teaches_nothing():
    made = estimator()
    for states in ([STICK] * 3, [SLIP] * 3):
        feel(made, [1.2] * 3, states, 200, fresh=False)
    np.testing.assert_array_equal(made.estimate, PRIOR)


def test_the_limits_hold():
    made = estimator()
    for _ in range(3):
        slip(made, [0.01] * 3, [0, 1, 2])
        rest(made, 0.1, 0.0)
    np.testing.assert_allclose(made.estimate, 0.1)
