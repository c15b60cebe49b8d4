# SPDX-License-Identifier: Apache-2.0
"""f* over ticks: steady under noise, balanced, and immediate if a cone requires it."""

import numpy as np
import pytest
from support.grasps import LOPSIDED, three_faces

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.optimizer.cones import (
    INSIDE,
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

GRASP = three_faces()
NO_LOAD = np.zeros((3, 3))


def optimum(friction):
    config = ForceOptimizerConfig(shape_time=0.0)
    return ForceOptimizer(config, 3).solve(GRASP, Cones(np.full(3, friction), NO_LOAD)).forces


@pytest.mark.parametrize("step", [0.0005, 0.001, 0.002, 0.004])
def test_after_the_same_time_it_is_as_far_at_any_rate(step):
    optimizer = ForceOptimizer(ForceOptimizerConfig(shape_time=0.05), 3)
    friction = np.full(3, 0.07)
    first = optimizer.solve(GRASP, Cones(friction, NO_LOAD)).forces
    load = np.array([[0.002, 0.0, 0.0], [-0.001, 0.0, 0.0], [0.0, 0.0, 0.0]])
    goal = ForceOptimizer(ForceOptimizerConfig(shape_time=0.0), 3)
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
        found, _ = followed(start, end, balance, load, friction, share)
        np.testing.assert_allclose(found, start + way * (end - start), atol=1e-12)
    assert kinds == {0, 1, 2}


def test_without_a_time_constant_the_optimum_is_followed_at_once():
    optimizer = ForceOptimizer(ForceOptimizerConfig(shape_time=0.0), 3)
    optimizer.solve(GRASP, Cones(np.full(3, 0.05), NO_LOAD, 0.001))
    found = optimizer.solve(GRASP, Cones(np.full(3, 0.07), NO_LOAD, 0.001)).forces
    np.testing.assert_allclose(found, optimum(0.07), atol=1e-12)
