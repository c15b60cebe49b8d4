# SPDX-License-Identifier: Apache-2.0
"""The compiled solver behind OSQP's Python class gives what that class gives."""

import subprocess
import sys

import numpy as np
import osqp
import pytest
from scipy import sparse

from tactile_hand_ros.control.optimizer.warm_solver import (
    INFEASIBLE,
    SOLVED,
    Sparse,
    WarmSolver,
    _known_as_sparse,
)

SETTINGS = {"eps_abs": 1e-9, "eps_rel": 1e-9, "polishing": True}


def test_answers_are_those_of_the_python_class():
    rng = np.random.default_rng(1)
    hessian = rng.uniform(1.0, 3.0, 4)
    price, matrix = rng.normal(size=4), rng.normal(size=(3, 4))
    lower, upper = -np.ones(3), np.array([1.0, 2.0, np.inf])
    ours = WarmSolver(hessian, price, Sparse.of(matrix), lower, upper, **SETTINGS)
    theirs = osqp.OSQP(algebra="builtin")
    theirs.setup(
        sparse.diags(hessian, format="csc"),
        price,
        sparse.csc_matrix(matrix),
        lower,
        upper,
        verbose=False,
        **SETTINGS,
    )
    for limit in (upper, upper, np.array([0.1, np.inf, 0.2])):
        values = rng.normal(size=matrix.size)
        x, y, info = ours.solve(values, limit)
        theirs.update(Ax=values, u=limit)
        expected = theirs.solve(raise_error=False)
        np.testing.assert_array_equal(x, expected.x)
        np.testing.assert_array_equal(y, expected.y)
        assert info.status_val == expected.info.status_val == osqp.SolverStatus.OSQP_SOLVED


def test_it_ends_in_the_same_ways():
    status = osqp.SolverStatus
    assert status.OSQP_SOLVED == SOLVED
    infeasible = (status.OSQP_PRIMAL_INFEASIBLE, status.OSQP_PRIMAL_INFEASIBLE_INACCURATE)
    assert infeasible == INFEASIBLE


def test_an_unknown_setting_is_an_error():
    one = np.ones(1)
    with pytest.raises(AttributeError, match="polish"):
        WarmSolver(one, one, Sparse.of(np.eye(1)), -one, one, polish=True)


def test_a_matrix_by_columns_is_that_of_scipy():
    rng = np.random.default_rng(2)
    dense = np.where(rng.random((5, 7)) < 0.4, rng.normal(size=(5, 7)), 0.0)
    dense[:, 2] = 0.0
    ours, theirs = Sparse.of(dense), sparse.csc_matrix(dense)
    for name in ("shape", "data", "indices", "indptr"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert type(getattr(ours, name)) is type(getattr(theirs, name))
    np.testing.assert_array_equal(ours.columns, theirs.tocoo().col)


LATER = """
import sys
import numpy as np
from tactile_hand_ros.control.optimizer.warm_solver import Sparse, WarmSolver
one = np.ones(1)
WarmSolver(one, one, Sparse.of(np.eye(1)), -one, one)
print("scipy.sparse" in sys.modules)
import osqp, scipy.sparse
print(sys.modules["osqp.ext_builtin"] is osqp.OSQP().ext, scipy.sparse.eye(2).nnz)
"""


def test_osqp_and_scipy_may_be_loaded_later():
    command = [sys.executable, "-c", LATER]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["False", "True", "2"]


def test_it_solves_without_a_word(capfd):
    one = np.ones(1)
    x, _, info = WarmSolver(one, -one, Sparse.of(np.eye(1)), -one, one, **SETTINGS).solve(one)
    assert info.status_val == SOLVED
    np.testing.assert_allclose(x, 1.0, atol=1e-6)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("is_loaded", [False, True])
def test_scipy_is_stood_in_for_only_while_a_matrix_is_taken(is_loaded, monkeypatch):
    if not is_loaded:
        monkeypatch.delitem(sys.modules, "scipy.sparse")
    before = sys.modules.get("scipy.sparse")
    with _known_as_sparse():
        knows = sys.modules["scipy.sparse"].isspmatrix_csc
        assert knows(Sparse.of(np.eye(2))) and not knows(np.eye(2))
    assert sys.modules.get("scipy.sparse") is before and (before is not None) == is_loaded
