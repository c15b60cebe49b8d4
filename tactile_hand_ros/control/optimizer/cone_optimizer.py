# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) inside friction cones, for grasps in which a larger k_f does not help.

A contact slips at any grasp force if f* itself leaves its cone. Here the force of each contact,
internal force and load, stays inside:

    min f^T W f + rho t + w t^2   s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum,  t >= 0,
    u_j . (f + l)_t <= mu cos(pi / 12) (f + l)_n + t    for twelve directions u_j,

with the load l per unit of internal force. The pyramid lies inside the cone, so that t = 0
certifies the friction. If no such f* exists, t is about the smallest common violation until the
grasp force rises. The linear penalty is exact: with rho above the price of a cone, t is zero if it
can be. See `quadratic_program` for the method.
"""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.optimizer.cones import DIRECTIONS, INSIDE, SIDES, Cones
from tactile_hand_ros.control.optimizer.quadratic_program import Problem, QuadraticProgram

_PENALTY = 5.0  # rho, relative to the largest weight
_SCALE = 0.3  # of the cost for its largest weight; conditions the dual variables


class ConeOptimizer:
    """Solves (13) inside friction cones; starts with the last active set."""

    def __init__(self, weights: Array, minimum: float, exact: bool = True) -> None:
        """Set up the problem.

        Args:
            weights: Diagonal of W, shape (3k,).
            minimum: Smallest normal force f_n of a contact.
            exact: Whether to use OSQP only if the exact method fails.
        """
        n, largest = len(weights), weights.max()
        k = n // 3
        weights = np.append(weights, largest) * (_SCALE / largest)
        price = np.append(np.zeros(n), _PENALTY * _SCALE)
        # -f_n <= -minimum, -t <= 0, and the cones, still without friction.
        rows, bounds = np.zeros((k + 1 + SIDES * k, n + 1)), np.zeros(k + 1 + SIDES * k)
        rows[:k, 1:n:3], bounds[:k] = -np.eye(k), -minimum
        rows[k + 1 :, :n] = np.kron(np.eye(k), np.insert(DIRECTIONS, 1, 0.0, axis=1))
        rows[k:, n] = -1.0
        equal, right = np.zeros((7, n + 1)), np.zeros(7)
        equal[6, 1:n:3] = right[6] = 1.0
        self._problem = Problem(weights, price, equal, right, rows, bounds)
        _set_numbers(self._problem, np.ones((n, 6)), np.ones(k), np.zeros((k, SIDES)))
        self._program = QuadraticProgram(self._problem, exact)

    def solve(self, balance: Array, cones: Cones) -> tuple[Array, float]:
        """Return f*, shape (k, 3), for G~^T, shape (3k, 6), and the residual of its optimality."""
        _set_numbers(self._problem, balance, cones.usable_friction, cones.goal)
        found = self._program.solve(self._problem)
        return found.x[:-1].reshape(-1, 3).copy(), found.residual


@compiled
def _set_numbers(problem: Problem, balance: Array, friction: Array, beyond: Array) -> None:
    """Write G~^T, (3k, 6), usable mu, (k,), and `Cones.goal`, (k, SIDES), into the problem."""
    n, k = balance.shape[0], len(friction)
    problem.equal[:6, :n] = balance.T
    problem.bounds[k + 1 :] = -beyond.ravel()
    for i in range(k):
        first = k + 1 + SIDES * i
        problem.rows[first : first + SIDES, 3 * i + 1] = -INSIDE * friction[i]
