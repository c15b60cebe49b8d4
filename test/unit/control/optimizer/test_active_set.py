# SPDX-License-Identifier: Apache-2.0
"""The exact solution of (13): the same from any start and by OSQP, and none where there is none."""

from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.grasps import contacts_at, grasps, pinch, three_faces

from tactile_hand_ros.control.optimizer.active_set import solve_exactly
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    optimality,
    scaled_balance,
)


def problem(contacts, values=(10.0, 1.0, 10.0)):
    balance = scaled_balance(contacts.positions, contacts.rotations)
    return balance, np.tile(values, len(contacts.positions))


@pytest.mark.parametrize("grasp", [three_faces, pinch])
@pytest.mark.parametrize("start", list(product([False, True], repeat=3)))
def test_every_start_ends_at_the_same_forces(grasp, start):
    balance, weights = problem(grasp())
    expected, _, _ = solve_exactly(balance, weights, 0.0, np.zeros(3, dtype=bool))
    held = np.array(start)
    x, y, systems = solve_exactly(balance, weights, 0.0, held)
    np.testing.assert_array_equal(y[7:][~held], 0.0)
    np.testing.assert_allclose(x, expected, atol=1e-13)
    assert systems and max(optimality(x, y, balance, weights, 0.0)) < 1e-13


def test_a_grasp_that_moves_little_takes_one_system():
    balance, weights = problem(three_faces())
    held = np.zeros(3, dtype=bool)
    solve_exactly(balance, weights, 0.2, held)
    assert held.any()
    _, _, systems = solve_exactly(balance, weights, 0.2, held)
    assert systems == 1


def test_where_nothing_balances_there_is_no_answer():
    points = 0.1 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    balance, weights = problem(contacts_at(points, np.tile([0.0, 0.0, 1.0], (3, 1))))
    held = np.zeros(3, dtype=bool)
    assert solve_exactly(balance, weights, 0.0, held)[2] == 0
    assert not held.any()


@settings(max_examples=100)
@given(grasps(), st.sampled_from([0.0, 0.05]))
def test_osqp_gives_the_same(contacts, least):
    k = len(contacts.positions)
    balance, weights = problem(contacts)
    x, _, systems = solve_exactly(balance, weights, least, np.zeros(k, dtype=bool))
    assume(systems and np.abs(x).max() < 100.0)
    solver = ForceOptimizer(ForceOptimizerConfig(minimum_normal=least, solver="osqp"), k)
    osqp = solver.solve(contacts)
    assume(osqp.ok)  # it gives up where a grasp hardly balances
    assert osqp.solve_time > 0.0
    np.testing.assert_allclose(osqp.forces.ravel(), x, atol=1e-7 * np.abs(x).max())
