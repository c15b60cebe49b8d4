# SPDX-License-Identifier: Apache-2.0
"""Friction cones and their pyramids, on hand-made forces, and how f* follows them over ticks."""

import math

import numpy as np
import pytest
from support.grasps import LOPSIDED, three_faces

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.optimizer.cones import (
    INSIDE,
    SIDES,
    Cones,
    _way_into_cones,
    balanced,
    followed,
    reaches,
)
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    scaled_balance,
)

MU = np.array([0.5, 0.3, 0.8])
FORCES = np.array([[0.1, 0.4, -0.05], [0.0, 0.5, 0.02], [-0.04, 0.1, 0.03]])
LOAD = np.array([[0.02, 0.1, 0.05], [-0.03, 0.1, 0.02], [0.01, 0.0, 0.01]])
# With the load: mu n is 0.25, 0.18 and 0.08; the tangents are (0.12, 0), (-0.03, 0.04), (-0.03,
# 0.04).
MARGINS = np.array([0.13, 0.13, 0.03])


def bears(force, friction=0.5, finger=1, load=(0.0, 0.0, 0.0)):
    """Return whether one of three contacts holds a force, next to two that always hold theirs."""
    forces, loads = np.tile([0.0, 1.0, 0.0], (3, 1)), np.zeros((3, 3))
    forces[finger], loads[finger] = force, load
    mu = np.full(3, 0.1)
    mu[finger] = friction
    return Cones(mu, loads).holds(forces)


def test_the_margin_is_that_of_the_contact_nearest_to_its_own_cone_with_its_load():
    assert Cones(MU, LOAD).margin(FORCES) == pytest.approx(0.03)
    for finger in range(3):
        forces = FORCES.copy()
        forces[finger, 0] += math.copysign(0.3, forces[finger, 0])
        x, n, z = forces[finger] + LOAD[finger]
        margin = MU[finger] * n - math.sqrt(x * x + z * z)
        assert margin < 0.0
        assert Cones(MU, LOAD).margin(forces) == pytest.approx(margin)
        alone = Cones(MU[[finger]], LOAD[[finger]]).margin(FORCES[[finger]])
        np.testing.assert_allclose(alone, MARGINS[finger])


@pytest.mark.parametrize("finger", range(3))
@pytest.mark.parametrize("side", range(SIDES))
def test_the_pyramid_has_twelve_sides_and_its_edges_on_the_cone(side, finger):
    """Across a side it reaches cos 15 degrees of mu f_n, along an edge mu f_n itself."""
    cone, normal = 0.5 * 2.0, np.array([0.0, 2.0, 0.0])
    for steps, reach in ((side, cone * math.cos(math.radians(15.0))), (side + 0.5, cone)):
        angle = math.radians(30.0) * steps
        tangential = reach * np.array([math.cos(angle), 0.0, math.sin(angle)])
        for share in (0.999, 1.001):
            assert bears(normal + share * tangential, finger=finger) == (share < 1.0)


def test_what_lies_on_a_side_is_borne():
    on = np.array([math.cos(math.pi / 12.0), 1.0, 0.0])
    assert bears(on, friction=1.0)
    assert not bears(on + [1e-15, 0.0, 0.0], friction=1.0)


def test_the_load_counts_for_the_pyramid_as_it_does_for_the_cone():
    assert bears([0.2, 1.0, 0.0]) and not bears([0.2, 1.0, 0.0], load=(0.3, 0.0, 0.0))
    assert not bears([0.6, 1.0, 0.0]) and bears([0.6, 1.0, 0.0], load=(0.0, 0.4, 0.0))
    assert bears([0.6, 1.0, 0.1], load=(-0.4, 0.0, -0.2))


def test_a_contact_that_pulls_is_outside_and_so_is_an_unknown_one():
    assert not bears([0.0, -1.0, 0.0])
    assert Cones(MU, 0.0 * LOAD).margin(-FORCES) < 0.0
    assert not bears([np.nan, 1.0, 0.0]) and not bears([0.0, np.nan, 0.0])


def test_f_is_made_for_what_is_wanted_where_that_is_more_than_the_load():
    wanted = np.full((3, SIDES), -1.0)
    loaded = Cones(MU, np.full((3, 3), 0.5))
    assert not loaded.holds(FORCES)
    assert Cones(MU, loaded.load, wanted=wanted).holds(FORCES)
    wanted[1, 4] = 0.5
    more = Cones(MU, 0.0 * LOAD, wanted=wanted)
    assert not more.holds(FORCES) and Cones(MU, 0.0 * LOAD).holds(FORCES)
    np.testing.assert_array_equal(more.goal, wanted)
    assert more.margin(FORCES) == Cones(MU, 0.0 * LOAD).margin(FORCES)


GRASP = three_faces()
NO_LOAD = np.zeros((3, 3))


@pytest.mark.parametrize("step", [0.0005, 0.001, 0.002, 0.004])
def test_after_the_same_time_it_is_as_far_at_any_rate(step):
    optimizer = ForceOptimizer(ForceOptimizerConfig(shape_time=0.05), 3)
    friction = np.full(3, 0.07)
    first = optimizer.solve(GRASP, Cones(friction, NO_LOAD)).forces
    load = np.array([[0.002, 0.0, 0.0], [-0.001, 0.0, 0.0], [0.0, 0.0, 0.0]])
    goal = ForceOptimizer(ForceOptimizerConfig(shape_time=0.0), 3)
    goal.solve(GRASP, Cones(friction, NO_LOAD))  # without a time constant it does not matter
    cones = Cones(friction, NO_LOAD, step, reaches(load, friction))
    wanted = goal.solve(GRASP, cones).forces
    assert np.abs(wanted - first).max() > 1e-4
    for _ in range(round(0.04 / step)):
        found = optimizer.solve(GRASP, cones)
    expected = wanted + np.exp(-0.8) * (first - wanted)
    np.testing.assert_allclose(found.forces, expected, atol=1e-9)
    assert found.residual < 1e-4


def test_it_follows_nothing_from_before_an_interruption_or_where_no_time_has_passed():
    low, high = Cones(np.full(3, 0.05), NO_LOAD, 0.001), Cones(np.full(3, 0.07), NO_LOAD, 0.001)
    expected = ForceOptimizer(ForceOptimizerConfig(), 3).solve(GRASP, high).forces
    missing = Contacts(np.full((3, 3), np.nan), GRASP.rotations)
    for interrupt in (
        lambda optimizer: optimizer.solve(GRASP),
        lambda optimizer: optimizer.reset(),
        lambda optimizer: optimizer.configure(ForceOptimizerConfig()),
    ):
        optimizer = ForceOptimizer(ForceOptimizerConfig(), 3)
        optimizer.solve(GRASP, low)
        interrupt(optimizer)
        found = optimizer.solve(GRASP, high).forces
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert not optimizer.solve(missing, low).ok
    assert np.abs(optimizer.solve(GRASP, low).forces - expected).max() > 1e-3
    still = Cones(high.usable_friction, NO_LOAD, 0.0)
    np.testing.assert_allclose(optimizer.solve(GRASP, still).forces, expected, atol=1e-12)


def test_a_force_exactly_on_a_side_need_go_nowhere():
    start, out = np.array([[0.5 * INSIDE, 1.0, 0.0]]), np.array([[1.0, 1.0, 0.0]])
    nothing, half = np.zeros((1, 3)), np.array([0.5])
    assert _way_into_cones(start, out, nothing, half) == 0.0
    assert _way_into_cones(start + [1e-9, 0.0, 0.0], out, nothing, half) == 1.0
    assert _way_into_cones(out, start, nothing, half) == 1.0
    assert _way_into_cones(out, start - [0.5 * INSIDE, 0.0, 0.0], nothing, half) < 1.0


def test_the_nearest_forces_in_balance_are_those_of_the_pseudoinverse():
    balance = scaled_balance(LOPSIDED.positions, LOPSIDED.rotations)
    rows = np.vstack([balance.T, np.tile([0.0, 1.0, 0.0], 4)])
    for seed in range(3):
        forces = np.random.default_rng(seed).standard_normal((4, 3))
        missing = rows @ forces.ravel() - np.eye(7)[6]
        expected = forces.ravel() - np.linalg.pinv(rows) @ missing
        found, ok = balanced(forces, balance)
        assert ok
        np.testing.assert_allclose(found.ravel(), expected, atol=1e-13)
        wrench, total = np.abs(forces.ravel() @ balance).max(), abs(forces[:, 1].sum() - 1.0)
        assert wrench == pytest.approx(np.abs(missing[:6]).max())
        assert total == pytest.approx(abs(missing[6]))
    line = balance.copy()
    line[:, 5] = line[:, 4]
    found, ok = balanced(forces, line)
    assert not ok
    np.testing.assert_array_equal(found, forces)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_it_goes_until_each_side_of_each_pyramid_is_met_and_all_the_way_if_one_never_is(share):
    """Friction and load differ between contacts."""
    balance = scaled_balance(LOPSIDED.positions, LOPSIDED.rotations)
    random, kinds = np.random.default_rng(4), set()
    for _ in range(60):
        shift = np.array([0.0, 0.3, 0.0])
        start, end, load = 0.2 * random.standard_normal((3, 4, 3)) + [[shift]] * 3
        friction = random.uniform(0.3, 3.0, 4)
        start, _ = balanced(start, balance)
        first, last = reaches(start + load, friction), reaches(end + load, friction)
        outside = first > 0.0
        ways = np.where(last < 0.0, first / (first - last), 1.0)[outside]
        way = max(share, ways.max(initial=0.0))
        kinds.add((way == share) + 2 * (way == 1.0))
        found = followed(start, end, balance, load, friction, share)
        np.testing.assert_allclose(found, start + way * (end - start), atol=1e-12)
    assert kinds == {0, 1, 2}
