# SPDX-License-Identifier: Apache-2.0
"""OSQP for a problem that is solved at every tick: set up once, then started from the last answer.

The compiled solver is asked directly. OSQP's Python class copies twenty numbers of statistics at
each call, which takes as long as solving, and the package around it loads SciPy's sparse matrices
and a template engine: a tenth of a second and 20 MiB.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.extension import load_extension

Array = NDArray[np.float64]

_osqp: Any = load_extension("osqp", "ext_builtin", is_shared=True)

_status = _osqp.osqp_status_type
SOLVED: int = _status.OSQP_SOLVED.value
INFEASIBLE: tuple[int, ...] = (
    _status.OSQP_PRIMAL_INFEASIBLE.value,
    _status.OSQP_PRIMAL_INFEASIBLE_INACCURATE.value,
)
"""How OSQP ends, as its statistics say in `status_val`."""


class Sparse(NamedTuple):
    """A matrix by columns, as OSQP takes it.

    Attributes:
        shape: Numbers of rows and columns.
        data: Numbers that are not zero, column by column, shape (p,).
        indices: Their rows, shape (p,).
        indptr: Where each column begins in them, and where the last one ends, shape (n + 1,).
    """

    shape: tuple[int, int]
    data: Array
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]

    @classmethod
    def of(cls, dense: Array) -> Sparse:
        """Return the numbers of a matrix that are not zero."""
        columns, rows = np.nonzero(dense.T)
        ends = np.cumsum(np.count_nonzero(dense, axis=0))
        starts = np.concatenate(([0], ends)).astype(np.int32)
        return cls(dense.shape, dense[rows, columns], rows.astype(np.int32), starts)

    @property
    def nnz(self) -> int:
        """Number of the numbers that are not zero."""
        return len(self.data)

    @property
    def columns(self) -> NDArray[np.int64]:
        """The columns of the numbers, shape (p,)."""
        return np.repeat(np.arange(self.shape[1]), np.diff(self.indptr))


class WarmSolver:
    """Minimises x^T P x / 2 + q^T x with l <= A x <= u."""

    def __init__(
        self,
        hessian: Array,
        price: Array,
        matrix: Sparse,
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
        self._settings = chosen = _osqp.OSQPSettings()
        _osqp.osqp_set_default_settings(chosen)
        for name, value in {"verbose": False, **settings}.items():
            setattr(chosen, name, value)
        self._infinity = _osqp.OSQP_INFTY
        bounds = np.maximum(lower, -self._infinity), np.minimum(upper, self._infinity)
        with _known_as_sparse():
            curvature, rows = _osqp.CSC(Sparse.of(np.diag(hessian))), _osqp.CSC(matrix)
        self._native = _osqp.OSQPSolver(curvature, price, rows, *bounds, *matrix.shape, chosen)

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


@contextlib.contextmanager
def _known_as_sparse() -> Iterator[None]:
    """Let OSQP take a `Sparse`: it asks SciPy about a matrix, and would load SciPy for that."""
    name = "scipy.sparse"
    own, theirs = ModuleType(name), sys.modules.get(name)
    own.isspmatrix_csc = lambda matrix: isinstance(matrix, Sparse)  # type: ignore[attr-defined]
    sys.modules[name] = own
    try:
        yield
    finally:
        del sys.modules[name]
        if theirs is not None:
            sys.modules[name] = theirs
