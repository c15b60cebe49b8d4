# SPDX-License-Identifier: Apache-2.0
"""OSQP for a problem solved at every tick: set up once, then started from the last answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)
INFEASIBLE = (
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE),
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE),
)


class WarmSolver:
    """Minimizes x^T P x / 2 + q^T x with l <= A x <= u."""

    def __init__(
        self,
        hessian: Array,
        price: Array,
        matrix: sparse.csc_matrix,
        lower: Array,
        upper: Array,
        **settings: Any,
    ) -> None:
        """Set the problem up.

        Args:
            hessian: The diagonal of P, shape (n,).
            price: q, shape (n,).
            matrix: A, shape (m, n); its pattern stays, its numbers may change.
            lower: l, shape (m,).
            upper: u, shape (m,).
            **settings: Of OSQP.
        """
        self._solver = osqp.OSQP(algebra="builtin")
        curvature = sparse.diags(hessian, format="csc")
        self._solver.setup(curvature, price, matrix, lower, upper, **{"verbose": False, **settings})

    def solve(self, values: Array, upper: Array | None = None) -> tuple[Array, Array, Any]:
        """Solve with other numbers.

        Args:
            values: Numbers of A in the order of its columns.
            upper: u, if it has changed.

        Returns:
            x and the multipliers y, which the next call overwrites, and OSQP's statistics.
        """
        self._solver.update(u=upper, Ax=values)
        answer = self._solver.solve(raise_error=False)
        return answer.x, answer.y, answer.info
