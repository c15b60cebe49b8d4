# SPDX-License-Identifier: Apache-2.0
"""f* from tick to tick: steady under noise, balanced, and at once where a cone asks for it."""

import numpy as np
import pytest
from support.grasps import three_faces

from tactile_hand_ros.control.optimizer.cones import Cones, reaches
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    scaled_balance,
)
from tactile_hand_ros.control.optimizer.steady import balanced, followed

GRASP = three_faces()
BALANCE = scaled_balance(GRASP.positions, GRASP.rotations)
MU = np.full(3, 0.5)
NO_LOAD = np.zeros((3, 3))


def optimum(friction):
    config = ForceOptimizerConfig(shape_time=0.0)
    return ForceOptimizer(config, 3).solve(GRASP, Cones(np.full(3, friction), NO_LOAD)).forces


def test_forces_near_a_grasp_are_brought_to_balance_and_no_farther():
    best = optimum(0.5)
    off = best + 1e-3 * np.random.default_rng(0).standard_normal((3, 3))
    found, ok = balanced(off, BALANCE)
    assert ok and np.abs(found.ravel() @ BALANCE).max() < 1e-12
    assert found[:, 1].sum() == pytest.approx(1.0)
    assert np.linalg.norm(found - off) <= np.linalg.norm(best - off)


def test_it_goes_its_share_of_the_way():
    start, end = optimum(0.5), optimum(0.05)
    found, ok = followed(start, end, BALANCE, NO_LOAD, MU, 0.25)
    assert ok
    np.testing.assert_allclose(found, start + 0.25 * (end - start), atol=1e-9)


def test_it_goes_as_far_as_the_learned_cones_ask():
    """Friction has fallen: the old f* would slip."""
    start, end, friction = optimum(0.5), optimum(0.05), np.full(3, 0.07)
    found, _ = followed(start, end, BALANCE, NO_LOAD, friction, 0.0)
    assert reaches(start, friction).max() > 0.0
    assert reaches(found, friction).max() < 1e-9
    back, _ = followed(start, end, BALANCE, NO_LOAD, friction + 0.01, 0.0)
    assert np.linalg.norm(back - start) < np.linalg.norm(found - start)


@pytest.mark.parametrize("step", [0.0005, 0.001, 0.002, 0.004])
def test_after_the_same_time_it_is_as_far_at_any_rate(step):
    optimizer = ForceOptimizer(ForceOptimizerConfig(shape_time=0.05), 3)
    first = optimizer.solve(GRASP, Cones(MU, NO_LOAD)).forces
    load = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.03, 0.0, 0.0]])
    goal = ForceOptimizer(ForceOptimizerConfig(shape_time=0.0), 3)
    wanted = goal.solve(GRASP, Cones(MU, load, step)).forces
    for _ in range(round(0.04 / step)):
        found = optimizer.solve(GRASP, Cones(MU, load, step))
    expected = wanted + np.exp(-0.8) * (first - wanted)
    np.testing.assert_allclose(found.forces, expected, atol=1e-6)
    assert found.residual < 1e-4
