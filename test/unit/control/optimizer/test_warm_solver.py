# SPDX-License-Identifier: Apache-2.0
"""The compiled solver behind OSQP's Python class gives what that class gives."""

import numpy as np
import osqp
from scipy import sparse

from tactile_hand_ros.control.optimizer.warm_solver import WarmSolver

SETTINGS = {"eps_abs": 1e-9, "eps_rel": 1e-9, "polishing": True}


def test_answers_are_those_of_the_python_class():
    rng = np.random.default_rng(1)
    hessian = sparse.diags(rng.uniform(1.0, 3.0, 4), format="csc")
    price, matrix = rng.normal(size=4), sparse.csc_matrix(rng.normal(size=(3, 4)))
    lower, upper = -np.ones(3), np.array([1.0, 2.0, np.inf])
    ours = WarmSolver(hessian, price, matrix, lower, upper, **SETTINGS)
    theirs = osqp.OSQP()
    theirs.setup(hessian, price, matrix, lower, upper, verbose=False, **SETTINGS)
    for limit in (upper, upper, np.array([0.1, np.inf, 0.2])):
        values = rng.normal(size=matrix.nnz)
        x, y, info = ours.solve(values, limit)
        theirs.update(Ax=values, u=limit)
        expected = theirs.solve(raise_error=False)
        np.testing.assert_array_equal(x, expected.x)
        np.testing.assert_array_equal(y, expected.y)
        assert info.status_val == expected.info.status_val == osqp.SolverStatus.OSQP_SOLVED
