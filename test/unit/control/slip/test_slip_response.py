# SPDX-License-Identifier: Apache-2.0
"""The grasp force rises on slip and loss, and returns, on hand-made signals."""

import math

import numpy as np
import pytest

from tactile_hand_ros.control.slip.grasp_force import SlipResponse, SlipResponseConfig

LIMIT, START = 60.0, 6.0
ALL, TWO, NONE = (np.array(t) for t in ([True] * 3, [True, True, False], [False] * 3))


def step(
    reflex, needed=math.nan, slips=False, slides=False, touching=ALL, rejected=NONE, dt=0.0125
):
    return reflex.step(needed, slips, slides, touching, rejected, LIMIT, dt)


def fresh(**values):
    return SlipResponse(SlipResponseConfig(rise_rate=1e6, **values), START)


def test_a_contact_that_comes_and_goes_does_not_wind_it_up():
    reflex = fresh(first_rise=2.0)
    for tick in range(40):
        step(reflex, START, touching=TWO if tick % 2 else ALL)
    assert reflex.grasp_force <= 2.0 * START + 1e-9


@pytest.mark.parametrize(("needed", "fall"), [(5.9, 1.0), (5.5, 1.0), (5.4, 1.2), (1.0, 10.0)])
def test_it_falls_by_its_minimum_rate_or_a_fraction_of_the_excess(needed, fall):
    reflex = fresh(release_rate=1.0, release_time=0.5)
    assert step(reflex, needed) == pytest.approx(START - 0.0125 * fall, rel=1e-12)
    for _ in range(2):
        step(reflex, 5.999)
    assert step(fresh(), 5.999) == 5.999  # no farther than necessary


@pytest.mark.parametrize(("ticks", "settled"), [(4, START), (5, 10.0)])
def test_after_a_twentieth_of_a_second_a_slip_is_met_from_the_present_grasp_force(ticks, settled):
    reflex = fresh(first_rise=1.5)
    for _ in range(ticks):  # four of them are exactly 50 ms
        assert step(reflex, 10.0) == 10.0
    assert step(reflex, slips=True) == max(10.0, 1.5 * settled)


def test_only_a_grasp_that_is_whole_settles():
    reflex = fresh(first_rise=3.0)
    for _ in range(10):
        assert step(reflex, 10.0, touching=TWO) == 10.0
    assert step(reflex, slips=True, touching=TWO) == 3.0 * START


def test_over_a_pause_without_samples_it_hardly_falls():
    """When a stopped computer continues, the grasp force steps down by a tick's worth only."""
    assert step(fresh(), 1.0, dt=1.0) == step(fresh(), 1.0, dt=0.02) == pytest.approx(START - 0.2)


@pytest.mark.parametrize(("dt", "growth"), [(0.0125, 2.0**1.25), (0.02, 4.0), (0.5, 4.0)])
def test_over_a_pause_it_doubles_twice_at_most(dt, growth):
    reflex = fresh(first_rise=1.5)
    assert step(reflex, slips=True, slides=True, dt=dt) == pytest.approx(growth * 1.5 * START)


def test_a_slide_grows_from_the_present_grasp_force_and_another_starts_again():
    reflex = fresh(first_rise=1.5, release_time=0.5, release_rate=1.0)
    assert step(reflex, 10.0) == 10.0
    grown = 10.0 * 2.0**1.25  # it doubles every 10 ms
    assert step(reflex, 6.0, slips=True, slides=True) == pytest.approx(grown)
    assert step(reflex, 6.0, slips=True) == pytest.approx(grown)  # it requests that until the end
    after = step(reflex, 6.0)
    assert after == pytest.approx(grown - 0.0125 * (grown - 6.0) / 0.5)
    again = step(reflex, 6.0, slips=True)
    assert again == pytest.approx(after - 0.0125 * (after - 1.5 * START) / 0.5)


def test_a_contact_is_lost_until_all_are_back_or_none_is_left():
    reflex = fresh(first_rise=1.5, release_time=0.5, release_rate=1.0)
    step(reflex, START)
    for _ in range(3):
        assert step(reflex, 0.0, touching=TWO) == 1.5 * START
    none = step(reflex, 20.0, touching=NONE)  # the last force counts, not the needed one
    assert none == pytest.approx(9.0 - 0.0125 * 3.0 / 0.5)
    assert step(reflex, none, touching=TWO) == none


def test_a_contact_whose_touch_is_rejected_is_lost_if_it_is_missing_afterwards():
    reflex = fresh(first_rise=1.5)
    step(reflex, START)
    for _ in range(2):  # until then, the grasp force neither rises nor falls
        assert step(reflex, 0.0, touching=TWO, rejected=~TWO) == START
    assert step(reflex, 0.0, touching=TWO) == 1.5 * START


def test_it_starts_over_from_another_grasp_force():
    reflex = fresh(first_rise=1.5)
    step(reflex, START)
    step(reflex, slips=True, slides=True)
    reflex.start(4.0)
    assert reflex.grasp_force == step(reflex, touching=TWO) == 4.0  # nothing is lost
    assert step(reflex, slips=True) == 6.0
