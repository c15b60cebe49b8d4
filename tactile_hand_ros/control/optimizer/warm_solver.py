# SPDX-License-Identifier: Apache-2.0
"""OSQP for a problem that is solved at every tick: set up once, then started from the last answer.

The Python class of OSQP copies twenty numbers of statistics at each call, which takes as long as
solving. So the compiled solver behind it is asked directly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
from numpy.typing import NDArray

Array = NDArray[np.float64]


class WarmSolver:
    """Minimises x^T P x / 2 + q^T x with l <= A x <= u."""

    def __init__(
        self, hessian: Any, price: Array, matrix: Any, lower: Array, upper: Array, **settings: Any
    ) -> None:
        """Set the problem up.

        Args:
            hessian: P, sparse, shape (n, n).
            price: q, shape (n,).
            matrix: A, sparse, shape (m, n); its pattern stays, its numbers may change.
            lower: l, shape (m,).
            upper: u, shape (m,).
            **settings: Of OSQP.
        """
        self._wrapper = osqp.OSQP()
        self._wrapper.setup(hessian, price, matrix, lower, upper, verbose=False, **settings)
        self._native = self._wrapper._solver
        self._infinity = self._wrapper.constant("OSQP_INFTY")

    def solve(self, values: Array, upper: Array | None = None) -> tuple[Array, Array, Any]:
        """Solve with other numbers.

        Args:
            values: Numbers of A in the order of its columns.
            upper: u, if it has changed.

        Returns:
            x and the multipliers y, which the next call overwrites, and OSQP's statistics.
        """
        native = self._native
        if upper is not None:
            native.update_data_vec(q=None, l=None, u=np.minimum(upper, self._infinity))
        native.update_data_mat(P_x=None, P_i=None, A_x=values, A_i=None)
        native.solve()
        return native.solution.x, native.solution.y, native.info
