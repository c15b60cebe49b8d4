# SPDX-License-Identifier: Apache-2.0
"""Strictly convex problems: optimal by certificate, from any start and by OSQP, or infeasible."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from support.grasps import LOPSIDED, grasps, three_faces

from tactile_hand_ros.control.optimizer.cone_optimizer import ConeOptimizer
from tactile_hand_ros.control.optimizer.cones import Cones
from tactile_hand_ros.control.optimizer.force_optimizer import scaled_balance
from tactile_hand_ros.control.optimizer.quadratic_program import (
    Problem,
    QuadraticProgram,
    residual,
    solve_problem,
)


def corner(rows, bounds, price):
    """Return the problem of the point nearest to -price / 2 in a region, whose sum is 1."""
    n, (rows, bounds, price) = len(price), (np.array(x, float) for x in (rows, bounds, price))
    return Problem(np.ones(n), price, np.ones((1, n)), np.ones(1), rows, bounds)


@settings(max_examples=60)
@given(grasps(), st.floats(0.1, 1.0), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05]))
def test_what_is_optimal_proves_it(contacts, friction, seed, minimum):
    """For a strictly convex problem, stationarity, feasibility and positive multipliers suffice."""
    k = len(contacts.positions)
    load = 0.3 * np.random.default_rng(seed).standard_normal((k, 3))
    optimizer = ConeOptimizer(np.tile([10.0, 1.0, 10.0], k), minimum)
    balance = scaled_balance(contacts.positions, contacts.rotations)
    forces, missing = optimizer.solve(balance, Cones(np.full(k, friction), load))
    size = max(1.0, np.abs(forces).max())
    assert missing < 1e-10 * size
    assert abs(forces[:, 1].sum() - 1.0) < 1e-10 * size
    assert forces[:, 1].min() > minimum - 1e-10 * size


def test_a_load_that_changes_little_takes_one_system():
    problem = corner(np.vstack([-np.eye(3), [[1.0, -1.0, 0.0]]]), np.zeros(4), [-4.0, 0.0, 3.0])
    held = np.zeros(4, dtype=bool)
    assert solve_problem(problem, held)[2] > 1
    assert held.any()
    x, _, systems = solve_problem(problem, held)
    assert systems == 1
    np.testing.assert_allclose(x, [0.5, 0.5, 0.0], atol=1e-15)


@pytest.mark.parametrize("start", range(2**4))
def test_every_start_ends_at_the_same_point(start):
    """Even from contradictory active sets, and with a duplicate row: a degenerate corner."""
    rows = np.vstack([-np.eye(3), [[-1.0, 0.0, 0.0]]])
    held = np.array([bool(start >> i & 1) for i in range(4)])
    problem = corner(rows, [0.0, 0.0, 0.0, 0.0], [8.0, -2.0, 0.0])
    x, y, systems = solve_problem(problem, held)
    assert systems and residual(problem, x, y) < 1e-14 and (y[1:] >= 0.0).all()
    np.testing.assert_allclose(x, [0.0, 1.0, 0.0], atol=1e-15)


def test_after_inequalities_that_contradict_each_other_the_next_start_is_empty():
    held = np.zeros(2, dtype=bool)
    assert solve_problem(corner([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0], [0, 0]), held)[2] == 0
    assert not held.any()


def uneven(seed, n=4, m=7):
    """Return a problem of irregular numbers with an interior point, and its brute-force optimum."""
    random = np.random.default_rng(seed)
    weights, price = random.uniform(0.3, 4.0, n), 6.0 * random.standard_normal(n)
    equal, rows, inside = (random.standard_normal(shape) for shape in ((1, n), (m, n), n))
    bounds = rows @ inside + random.uniform(0.0, 0.5, m)
    problem = Problem(weights, price, equal, equal @ inside, rows, bounds)
    best, lowest = None, np.inf
    for held in itertools.product([False, True], repeat=m):
        held = np.array(held)
        if held.sum() >= n:
            continue
        a, b = np.vstack([equal, rows[held]]), np.append(problem.right, bounds[held])
        zeros = np.zeros((len(a), len(a)))
        system = np.block([[np.diag(2.0 * weights), a.T], [a, zeros]])
        x = np.linalg.solve(system, np.append(-price, b))[:n]
        cost = x @ (weights * x) + price @ x
        if (rows @ x <= bounds + 1e-9).all() and cost < lowest:
            best, lowest = (x, held), cost
    return problem, *best


# Number of linear systems that each problem solves from a cold start, one per step.
TAKEN = {0: 5, 1: 7, 2: 7, 3: 5, 4: 3, 5: 5}


@pytest.mark.parametrize("seed", TAKEN)
@pytest.mark.parametrize(("unit", "exactness"), [(1.0, 1e-11), (1e7, 1e-9)])
def test_uneven_problems_have_the_optimum_of_all_sets_in_known_steps(seed, unit, exactness):
    """In a small unit, active rows miss their bounds by rounding, which is a large number."""
    problem, expected, active = uneven(seed)
    problem = problem._replace(rows=unit * problem.rows, bounds=unit * problem.bounds)
    held = np.zeros(7, dtype=bool)
    x, y, systems = solve_problem(problem, held)
    np.testing.assert_allclose(x, expected, atol=exactness)
    np.testing.assert_array_equal(held, active)
    np.testing.assert_array_equal(y[1:] > 0.0, active)
    assert systems == TAKEN[seed]
    random = np.random.default_rng(seed)
    for _ in range(4):
        held = random.random(7) < 0.4
        x, _, systems = solve_problem(problem, held)
        assert systems
        np.testing.assert_allclose(x, expected, atol=exactness)
        np.testing.assert_array_equal(held, active)


def test_the_residual_is_the_largest_of_all_conditions():
    """Relative to the largest unknown above 1, the slope also to the largest weight."""
    for seed in range(8):
        problem, *_ = uneven(seed)
        random = np.random.default_rng(seed)
        x, y = random.standard_normal(4), (0.1 if seed % 2 else 2.0) * random.standard_normal(8)
        if seed > 3:
            problem = problem._replace(bounds=problem.bounds + 20.0, right=20.0 + problem.right)
            x = 9.0 * x
        push, excess = np.maximum(y[1:], 0.0), problem.rows @ x - problem.bounds
        slopes = 2.0 * problem.weights * x + problem.price + problem.equal[0] * y[0]
        slopes += problem.rows.T @ push
        parts = (
            np.abs(problem.equal @ x - problem.right).max(),
            excess.max(),
            np.abs(push * excess).max() / max(np.abs(y).max(), problem.weights.max()),
            np.abs(slopes).max() / problem.weights.max(),
        )
        expected = max(parts) / max(1.0, np.abs(x).max())
        assert residual(problem, x, y) == pytest.approx(expected, rel=1e-12)
    assert residual(problem, x * [1.0, np.nan, 1.0, 1.0], y) == np.inf


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("exact", [True, False])
def test_a_program_finds_the_optimum_and_starts_from_its_last(seed, exact):
    problem, expected, _ = uneven(seed)
    program = QuadraticProgram(problem._replace(rows=np.ones_like(problem.rows)), exact)
    first, again = program.solve(problem), program.solve(problem)
    for found in (first, again):
        np.testing.assert_allclose(found.x, expected, atol=1e-8)
        assert found.residual < 1e-9 and (found.solve_time > 0.0) == (not exact)
        assert found.osqp_status == ""
    assert again.iterations < first.iterations or first.iterations == 5


def test_a_program_without_an_answer_says_so_and_the_next_one_is_none_the_worse():
    program = QuadraticProgram(corner(np.ones((2, 2)), np.zeros(2), np.zeros(2)), True)
    none = program.solve(corner([[1.0, 0.0], [-1.0, 0.0]], [-1.0, -1.0], [0.0, 0.0]))
    assert "primal infeasible" in none.osqp_status and not none.residual < 1e-3
    found = program.solve(corner([[-1.0, 0.0], [0.0, 1.0]], [-0.25, 0.0], [0.0, 0.0]))
    np.testing.assert_allclose(found.x, [1.0, 0.0], atol=1e-9)
    assert found.residual < 1e-12


def documented(balance, weights, minimum, friction, load):
    """Return f* and t of the documented problem, by another method."""
    k, largest = len(friction), weights.max()
    angles = np.radians(30.0) * np.arange(12)

    def room(z):
        forces = z[:-1].reshape(k, 3) + load
        across = np.outer(forces[:, 0], np.cos(angles)) + np.outer(forces[:, 2], np.sin(angles))
        inside = np.cos(np.pi / 12.0) * friction * forces[:, 1]
        return np.concatenate([(inside[:, None] + z[-1] - across).ravel(), z[1:-1:3] - minimum])

    def cost(z):
        return (z[:-1] @ (weights * z[:-1])) / largest + 5.0 * z[-1] + z[-1] ** 2

    found = minimize(
        cost,
        np.append(np.tile([0.0, 1.0 / k, 0.0], k), 1.0),
        jac=lambda z: np.append(2.0 * weights * z[:-1] / largest, 5.0 + 2.0 * z[-1]),
        method="SLSQP",
        bounds=[(None, None)] * (3 * k) + [(0.0, None)],
        constraints=[
            {"type": "eq", "fun": lambda z: balance.T @ z[:-1]},
            {"type": "eq", "fun": lambda z: z[1:-1:3].sum() - 1.0},
            {"type": "ineq", "fun": room},
        ],
        options={"ftol": 1e-14, "maxiter": 300},
    )
    return found.x[:-1].reshape(k, 3), found.x[-1]


@pytest.mark.parametrize(("size", "violated"), [(0.02, False), (0.1, True), (3.0, True)])
@pytest.mark.parametrize("minimum", [0.0, 0.1])
def test_the_problem_is_the_documented_one(size, violated, minimum):
    """Weights, friction and load differ between contacts; t is the price of a cone."""
    random = np.random.default_rng(3)
    weights, friction = random.uniform(0.5, 12.0, 12), np.array([0.9, 1.5, 1.1, 1.3])
    load = size * random.standard_normal((4, 3))
    balance = scaled_balance(LOPSIDED.positions, LOPSIDED.rotations)
    expected, t = documented(balance, weights, minimum, friction, load)
    assert (t > 1e-3) == violated
    for exact in (True, False):
        found, _ = ConeOptimizer(weights, minimum, exact).solve(balance, Cones(friction, load))
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_an_exact_answer_that_has_lost_its_digits_is_not_taken():
    """Weights that differ by a factor of 1e9 leave residuals of some 1e-8."""
    balance = scaled_balance(three_faces().positions, three_faces().rotations)
    cones = Cones(np.full(3, 0.05), np.zeros((3, 3)), wanted=np.full((3, 12), -0.01))
    for large, is_asked in ((1e6, False), (1e9, True)):
        weights = np.array([large, 1.0, large, 1.0, large, 1.0, 1.0, 1.0, large])
        optimizer = ConeOptimizer(weights, 0.0)
        optimizer.solve(balance, cones)
        assert (optimizer._program._osqp is not None) == is_asked
