# SPDX-License-Identifier: Apache-2.0
"""A strictly convex quadratic program with few active inequalities, solved at every tick.

    min x^T W x + q^T x   s.t.  E x = e,  R x <= b

`solve_problem` is the dual method of Goldfarb and Idnani (1983). From an optimum under some
inequalities, the most violated one enters, and those whose multipliers reach zero leave. It starts
with the active set of the last tick, so that one linear system is nearly always enough:
A W^-1 A^T y = -2 b - A W^-1 q, from 2 W x + q + A^T y = 0 and A x = b. Matrices are small and are
factorized again, so that rounding errors do not add up.

`QuadraticProgram` falls back to OSQP, and accepts a solution by its residual.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import Array, compiled

_ROUNDING = 1e-12  # of the largest unknown or multiplier above 1; smaller violations are rounding
_DEPENDENT = 1e-13  # fraction of a row that remains if it depends on the active ones
_MAX_SYSTEMS = 100
_GOOD_RESIDUAL = 1e-10  # a larger one means lost digits
_TOLERANCE = 1e-6  # of OSQP before polishing
_SOLVED = int(osqp.SolverStatus.OSQP_SOLVED)


class Problem(NamedTuple):
    """The numbers of a problem with n unknowns.

    Attributes:
        weights: Diagonal of W, shape (n,).
        price: q, shape (n,).
        equal: E, shape (e, n).
        right: e, shape (e,).
        rows: R, shape (m, n).
        bounds: b, shape (m,).
    """

    weights: Array
    price: Array
    equal: Array
    right: Array
    rows: Array
    bounds: Array


class Solution(NamedTuple):
    """A solution with its residual.

    Attributes:
        x: The unknowns, shape (n,).
        residual: See `residual`; infinite without a solution.
        iterations: Number of linear systems, or iterations of OSQP.
        solve_time: Time in OSQP, s; 0 if it was not used.
        osqp_status: Status of OSQP if it did not solve the problem; empty otherwise.
    """

    x: Array
    residual: float
    iterations: int
    solve_time: float = 0.0
    osqp_status: str = ""


class QuadraticProgram:
    """Solves problems of one shape: exactly, and by OSQP if that fails or always.

    Source: Goldfarb and Idnani, 1983; Stellato et al., OSQP, 2020.
    """

    def __init__(self, example: Problem, exact: bool) -> None:
        """Start without an active set.

        Args:
            example: A problem with the weights, price and right sides of all; zeros of its E and R
                are zeros in all.
            exact: Whether to use OSQP only if the exact method fails.
        """
        self._example, self._exact = example, exact
        pattern = np.vstack([example.equal, example.rows]) != 0.0
        self._matrix = sparse.csc_matrix(pattern.astype(float))
        self._held = np.zeros(len(example.rows), dtype=np.bool_)
        self._osqp: Any = None

    def solve(self, problem: Problem) -> Solution:
        """Return the solution with the smaller residual, whatever the status of OSQP.

        OSQP may find the optimum although it reports its limit of iterations, or infeasibility for
        a large x.
        """
        exact = Solution(*_solved(problem, self._held))
        if exact.residual < _GOOD_RESIDUAL and self._exact:
            return exact
        return self._by_osqp(problem, exact)

    def _by_osqp(self, problem: Problem, exact: Solution) -> Solution:
        if self._osqp is None:
            self._set_up()
        values = np.vstack([problem.equal, problem.rows])[self._places]
        self._osqp.update(u=np.append(problem.right, problem.bounds), Ax=values)
        found = self._osqp.solve(raise_error=False)
        info, x, y = found.info, np.array(found.x), np.array(found.y)
        osqp_status = "" if info.status_val == _SOLVED else str(info.status)
        if osqp_status:
            self._osqp = None  # a bad start for the next problem
        how = int(info.iter), float(info.run_time), osqp_status
        best = Solution(x, residual(problem, x, y), *how)
        if best.residual < _GOOD_RESIDUAL or best.residual <= exact.residual:
            return best
        return Solution(exact.x, exact.residual, *how)

    def _set_up(self) -> None:
        weights, price, _, right, rows, bounds = self._example
        matrix = self._matrix
        self._places = matrix.indices, np.repeat(np.arange(len(price)), np.diff(matrix.indptr))
        self._osqp = osqp.OSQP(algebra="builtin")
        self._osqp.setup(
            sparse.diags(2.0 * weights, format="csc"),
            price,
            matrix,
            np.append(right, np.full(len(rows), -np.inf)),
            np.append(right, bounds),
            verbose=False,
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            polishing=True,
            warm_starting=True,
            max_iter=4000,
            check_termination=5,
            adaptive_rho_interval=25,  # by iterations, never by time: equal inputs, equal answers
        )


@compiled
def _solved(problem: Problem, held: Flags) -> tuple[Array, float, int]:
    """Return the optimum of `solve_problem`, its residual and the number of linear systems."""
    x, multipliers, systems = solve_problem(problem, held)
    return x, residual(problem, x, multipliers) if systems else np.inf, systems


@compiled
def solve_problem(problem: Problem, held: Flags) -> tuple[Array, Array, int]:
    """Return the optimum, of (13) for example, its multipliers, and the number of linear systems.

    The optimum has the shape (n,). `held` are the active inequalities at the start, shape (m,),
    overwritten with those at the end. Multipliers are those of equations and inequalities, shape
    (e + m,). Without a solution the number of systems is 0.
    """
    e, systems = len(problem.equal), 0
    x, multipliers = np.zeros(len(problem.price)), np.zeros(e + len(held))
    y = multipliers[e:]
    while systems < _MAX_SYSTEMS:
        systems += 1
        if not _optimum(problem, held, x, multipliers):
            if not held.any():
                break
            held[:] = False  # too many; start again without any
            continue
        pulling = int(np.argmin(y))
        if y[pulling] < -_ROUNDING * max(1.0, np.abs(y).max()):
            held[pulling] = False
            continue
        excess = problem.rows @ x - problem.bounds
        excess[held] = 0.0
        worst = int(np.argmax(excess))
        if not excess[worst] > _ROUNDING * max(1.0, np.abs(x).max()):
            return x, multipliers, systems
        taken = _activate(problem, held, worst, excess[worst], y)
        systems += taken
        if not taken:
            break
    held[:] = False
    return x, multipliers, 0


@compiled
def residual(problem: Problem, x: Array, multipliers: Array) -> float:
    """Return the largest violation of the optimality conditions; infinite if one is not finite.

    Constraints, slope of the Lagrangian per largest weight, and complementarity, each relative to
    the largest unknown if that is above 1. Multipliers are as in `solve_problem`.
    """
    if not (np.isfinite(x).all() and np.isfinite(multipliers).all()):
        return np.inf
    e = len(problem.equal)
    y, push = multipliers[:e], np.maximum(multipliers[e:], 0.0)
    slopes = 2.0 * problem.weights * x + problem.price + y @ problem.equal + push @ problem.rows
    missing, excess = problem.equal @ x - problem.right, problem.rows @ x - problem.bounds
    pull, largest = np.abs(multipliers).max(), problem.weights.max()
    loose = np.abs(push * excess).max() / max(pull, largest)
    worst = max(np.abs(missing).max(), excess.max(), loose, np.abs(slopes).max() / largest)
    return float(worst / max(np.abs(x).max(), 1.0))


@compiled
def _optimum(problem: Problem, held: Flags, x: Array, multipliers: Array) -> bool:
    """Write the optimum under active inequalities; return whether it is determined."""
    e, weights, (rows, right) = len(problem.equal), problem.weights, _active(problem, held)
    multipliers[:] = 0.0
    factor, determined = factorize(rows / weights @ rows.T)
    if not determined:
        return False
    y = np.zeros(len(rows))
    x[:] = -0.5 * problem.price / weights
    for _ in range(2):  # the second time removes the rounding errors of the first
        more = -2.0 * (right - rows @ x)
        substitute(factor, more.reshape(-1, 1))
        y += more
        x[:] = -0.5 * (problem.price + y @ rows) / weights
    multipliers[:e] = y[:e]
    multipliers[e:][held] = y[e:]
    return True


@compiled
def _active(problem: Problem, held: Flags) -> tuple[Array, Array]:
    """Return the active rows and their right sides."""
    rows = np.concatenate((problem.equal, problem.rows[held]))
    return rows, np.concatenate((problem.right, problem.bounds[held]))


@compiled
def _activate(problem: Problem, held: Flags, entering: int, excess: float, y: Array) -> int:
    """Make a violated inequality active; return the number of systems, 0 if that is impossible.

    Its multiplier grows until it holds. Active ones leave when their multipliers reach zero. Active
    inequalities and multipliers, both of shape (m,), are updated.
    """
    for systems in range(1, _MAX_SYSTEMS):
        fall, gain = _direction(problem, held, problem.rows[entering])
        step, leaving = excess / gain if gain > 0.0 else np.inf, -1
        for j in range(len(held)):
            if held[j] and fall[j] > 0.0 and y[j] < step * fall[j]:
                step, leaving = max(y[j], 0.0) / fall[j], j
        if step == np.inf:
            return 0
        y -= step * fall
        if leaving < 0:
            held[entering] = True
            return systems
        held[leaving] = False
        excess -= step * gain
    return 0


@compiled
def _direction(problem: Problem, held: Flags, row: Array) -> tuple[Array, float]:
    """Return the change of the optimum per unit of the multiplier of another row.

    The fall of the multipliers of the active inequalities, shape (m,), and of the violation of the
    row, 0 if the active rows determine x.
    """
    fall, weights, (rows, _) = np.zeros(len(held)), problem.weights, _active(problem, held)
    factor, determined = factorize(rows / weights @ rows.T)
    if not determined:
        return fall, 0.0
    projected = rows @ (row / weights)
    substitute(factor, projected.reshape(-1, 1))
    fall[held] = projected[len(problem.equal) :]
    left = row - projected @ rows
    gain: float = 0.5 * (left * left / weights).sum()
    total = 0.5 * (row * row / weights).sum()
    return fall, gain if gain > _DEPENDENT * total else 0.0


Flags = NDArray[np.bool_]
