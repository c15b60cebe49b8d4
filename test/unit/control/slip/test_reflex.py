# SPDX-License-Identifier: Apache-2.0
"""How the squeeze rises on slip and loss, and comes back, on signals made by hand."""

import math

import numpy as np
import pytest

from tactile_hand_ros.control.slip.reflex import Reflex, ReflexConfig

DT, LIMIT, START = 0.001, 60.0, 6.0
ALL, TWO, NONE = (np.array(t) for t in ([True] * 3, [True, True, False], [False] * 3))


def held(**values):
    """Return a reflex that has held with the squeeze of the start for a while."""
    reflex = Reflex(ReflexConfig(**values), START)
    run(reflex, 200, needed=START)
    return reflex


def run(reflex, ticks, needed=math.nan, slips=False, slides=False, touching=ALL):
    """Return the squeeze at each of some ticks."""
    return np.array([reflex.step(needed, slips, slides, touching, LIMIT, DT) for _ in range(ticks)])


def test_it_follows_the_need_up_at_its_rate_and_down_slowly():
    reflex = held(rise_rate=4000.0, release_time=0.5)
    up = run(reflex, 10, needed=20.0)
    assert up[0] == pytest.approx(START + 4.0) and up[-1] == 20.0
    down = run(reflex, 500, needed=START)
    assert down[-1] - START == pytest.approx(14.0 * math.exp(-1.0), rel=0.05)


def test_a_slip_doubles_the_squeeze_at_once_and_again_while_it_goes_on():
    reflex = held(first_rise=2.0, doubling_time=0.01)
    found = run(reflex, 13, slips=True, slides=True)
    assert found[0] == pytest.approx(START + 4.0)  # as fast as it may
    assert found[2] > 2.0 * START
    assert found[12] == pytest.approx(2.0 * START * 2.0**1.3, rel=0.01)


def test_it_grows_no_more_once_the_samples_tell_of_stick():
    """The detector goes on to say slip for some samples; that is no reason to squeeze harder."""
    reflex = held()
    caught = run(reflex, 5, slips=True, slides=True)[-1]
    assert run(reflex, 20, slips=True).max() == pytest.approx(caught)


def test_a_slip_never_takes_it_beyond_the_limit():
    assert run(held(), 200, slips=True, slides=True).max() == LIMIT


def test_a_lost_contact_doubles_the_squeeze_once():
    """Nothing can be computed of two contacts; what they have is held harder, not ever harder."""
    found = run(held(first_rise=2.0), 500, touching=TWO)
    assert found[2] == pytest.approx(2.0 * START) and found.max() == pytest.approx(2.0 * START)


def test_a_contact_that_comes_and_goes_does_not_wind_it_up():
    reflex = held(first_rise=2.0)
    for _ in range(20):
        run(reflex, 5, needed=START, touching=TWO)
        run(reflex, 5, needed=START)
    assert reflex.squeeze <= 2.0 * START + 1e-9


def test_fingers_that_have_not_yet_held_anything_lose_nothing():
    assert run(Reflex(ReflexConfig(), START), 100, touching=TWO).max() == START


def test_without_any_contact_it_comes_back():
    reflex = held(first_rise=2.0)
    run(reflex, 20, touching=TWO)
    gone = run(reflex, 3000, touching=NONE)
    assert gone[0] > 1.9 * START and gone[-1] == pytest.approx(START, rel=0.01)
    # What closes again, finger by finger, does not take that for another loss.
    assert run(reflex, 100, touching=TWO).max() < 1.01 * START
