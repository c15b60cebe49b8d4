# SPDX-License-Identifier: Apache-2.0
"""OSQP, set up once, answers each problem as when it is set up for it."""

import numpy as np
import osqp
from scipy import sparse

from tactile_hand_ros.control.optimizer.warm_solver import INFEASIBLE, SOLVED, WarmSolver

SETTINGS = {"eps_abs": 1e-9, "eps_rel": 1e-9, "polishing": True}


def test_answers_are_those_of_a_problem_set_up_for_them():
    rng = np.random.default_rng(1)
    hessian = rng.uniform(1.0, 3.0, 4)
    price, matrix = rng.normal(size=4), rng.normal(size=(3, 4))
    lower, upper = -np.ones(3), np.array([1.0, 2.0, np.inf])
    ours = WarmSolver(hessian, price, sparse.csc_matrix(matrix), lower, upper, **SETTINGS)
    for limit in (None, upper, np.array([0.1, np.inf, 0.2])):
        matrix = rng.normal(size=matrix.shape)
        x, y, info = ours.solve(matrix.T.ravel(), limit)
        theirs = osqp.OSQP()
        rows, top = sparse.csc_matrix(matrix), upper if limit is None else limit
        curvature = sparse.diags(hessian, format="csc")
        theirs.setup(curvature, price, rows, lower, top, verbose=False, **SETTINGS)
        expected = theirs.solve(raise_error=False)
        np.testing.assert_allclose(x, expected.x, atol=1e-9)
        np.testing.assert_allclose(y, expected.y, atol=1e-9)
        assert info.status_val == SOLVED


def test_a_problem_without_an_answer_is_reported():
    one = np.ones(1)
    solver = WarmSolver(
        one, one, sparse.csc_matrix(np.ones((2, 1))), np.array([1.0, -9.0]), one[[0, 0]]
    )
    assert solver.solve(np.ones(2), np.array([1.0, 0.0]))[2].status_val in INFEASIBLE
