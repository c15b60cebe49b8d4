# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) inside friction cones: reshape the squeeze where more of it does not help.

A contact slips however hard one squeezes when f* itself leaves its cone. Here f* is found such that
the whole force of each contact, squeeze and load, stays inside:

    min f^T W f + rho t + w t^2   s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum,  t >= 0,
    u_j . (f + l)_t <= mu cos(pi / 12) (f + l)_n + t    for twelve directions u_j,

with l the load per unit of squeeze. The pyramid lies inside the cone, so that t = 0 certifies the
friction. Where no such f* exists, t is about the least common violation: the best that can be done
until the squeeze is raised. The linear penalty is exact: with rho above the price of a cone, t
stays at zero wherever it can.

The answer is found exactly, see `cone_active_set`; where that fails, OSQP decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.optimizer.cones import DIRECTIONS, INSIDE, SIDES, Cones
from tactile_hand_ros.control.optimizer.exact import Problem, solve_problem, violation
from tactile_hand_ros.control.optimizer.warm_solver import WarmSolver

Array = NDArray[np.float64]

_PENALTY = 5.0  # rho, relative to the largest weight
_SCALE = 0.3  # of the cost for its largest weight; conditions the dual variables
_TOLERANCE = 1e-5  # of OSQP, from which polishing reaches rounding
_GOOD_VIOLATION = 1e-10  # above it the exact answer has lost its digits


class ConeOptimizer:
    """Solves (13) inside friction cones; set up once, begins with what was active last."""

    def __init__(self, weights: Array, minimum: float, exact: bool = True) -> None:
        """Set up the problem.

        Args:
            weights: Diagonal of W, shape (3k,).
            minimum: Least share f_n of a contact.
            exact: Whether to ask OSQP only where the exact answer fails.
        """
        n, largest = len(weights), weights.max()
        self._k, self._exact = n // 3, exact
        weights = np.append(weights, largest) * (_SCALE / largest)
        price = np.append(np.zeros(n), _PENALTY * _SCALE)
        rows = _fixed_rows(self._k)
        bounds = np.zeros(len(rows))
        bounds[: self._k] = -minimum
        equal, right = np.zeros((7, n + 1)), np.zeros(7)
        equal[6, 1:n:3] = right[6] = 1.0
        self._fixed = Problem(weights, price, equal, right, rows, bounds)
        self._held = np.zeros(len(rows), dtype=np.bool_)
        self._solver: WarmSolver | None = None

    def solve(self, balance: Array, cones: Cones) -> tuple[Array, float]:
        """Return f*, shape (k, 3), and the largest violation of the optimality conditions.

        Args:
            balance: G~^T for forces in contact frames, shape (3k, 6).
            cones: Usable friction and load of the contacts.
        """
        numbers = balance, cones.usable_friction, cones.goal
        if self._exact:
            forces, missing, systems = _exact_answer(self._fixed, *numbers, self._held)
            if systems and missing < _GOOD_VIOLATION:
                return forces, missing
        return self._by_osqp(_with_numbers(self._fixed, *numbers))

    def _by_osqp(self, problem: Problem) -> tuple[Array, float]:
        if self._solver is None:
            self._set_up()
        assert self._solver is not None
        values = np.vstack([problem.equal, problem.rows])[self._places]
        x, y, _ = self._solver.solve(values, np.append(problem.right, problem.bounds))
        if not np.isfinite(x).all() or not np.isfinite(y).all():
            return np.full((self._k, 3), np.nan), np.inf
        return x[:-1].reshape(self._k, 3).copy(), violation(problem, np.array(x), np.array(y))

    def _set_up(self) -> None:
        weights, price, equal, right, rows, bounds = self._fixed
        n, k = len(price) - 1, self._k
        # What any numbers may fill: the balance, and how the cones depend on the normal forces.
        pattern = np.vstack([equal, rows]) != 0.0
        pattern[:6, :n] = True
        for i in range(k):
            pattern[7:][_cone_rows(i, k), 3 * i + 1] = True
        matrix = sparse.csc_matrix(pattern.astype(float))
        self._places = matrix.indices, np.repeat(np.arange(n + 1), np.diff(matrix.indptr))
        self._solver = WarmSolver(
            2.0 * weights,
            price,
            matrix,
            np.append(right, np.full(len(rows), -np.inf)),
            np.append(right, bounds),
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            polishing=True,
            warm_starting=True,
            max_iter=2000,
            check_termination=10,
            adaptive_rho_interval=50,
        )


def _cone_rows(contact: int, contacts: int) -> slice:
    first = contacts + 1 + SIDES * contact
    return slice(first, first + SIDES)


def _fixed_rows(k: int) -> Array:
    """Return the rows of -f_n <= -minimum, -t <= 0 and the cones, without the latters' friction."""
    n = 3 * k
    rows = np.zeros((k + 1 + SIDES * k, n + 1))
    rows[np.arange(k), 1 + 3 * np.arange(k)] = -1.0
    rows[k, n] = -1.0
    for i in range(k):
        cone = _cone_rows(i, k)
        rows[cone, 3 * i : 3 * i + 3 : 2] = DIRECTIONS
        rows[cone, n] = -1.0
    return rows


@compiled
def _exact_answer(
    fixed: Problem, balance: Array, friction: Array, beyond: Array, held: NDArray[np.bool_]
) -> tuple[Array, float, int]:
    """Return f*, the largest violation of its conditions and the number of systems, 0 for none."""
    problem = _with_numbers(fixed, balance, friction, beyond)
    x, multipliers, systems = solve_problem(problem, held)
    return x[:-1].copy().reshape(-1, 3), violation(problem, x, multipliers), systems


@compiled
def _with_numbers(fixed: Problem, balance: Array, friction: Array, beyond: Array) -> Problem:
    """Return the problem with its numbers.

    Args:
        fixed: What stays.
        balance: G~^T, shape (3k, 6).
        friction: Usable mu, shape (k,).
        beyond: How far the load reaches beyond each side of the pyramids, shape (k, SIDES).
    """
    equal, rows, bounds = fixed.equal.copy(), fixed.rows.copy(), fixed.bounds.copy()
    n, k = balance.shape[0], len(friction)
    equal[:6, :n] = balance.T
    for i in range(k):
        for j in range(SIDES):
            row = k + 1 + SIDES * i + j
            rows[row, 3 * i + 1] = -INSIDE * friction[i]
            bounds[row] = -beyond[i, j]
    return Problem(fixed.weights, fixed.price, equal, fixed.right, rows, bounds)
