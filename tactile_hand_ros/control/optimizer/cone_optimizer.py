# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) inside friction cones: reshape the squeeze where squeezing more is no help.

A contact slips however hard one squeezes when f* itself leaves its cone. Here f* is found such that
the whole force of each contact, squeeze and load, stays inside:

    min f^T W f + rho t + w t^2   s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum,  t >= 0,
    u_j . (f + l)_t <= mu cos(pi / 12) (f + l)_n + t    for twelve directions u_j,

with l the load per unit of squeeze. The pyramid lies inside the cone, so that t = 0 certifies the
friction. Where no such f* exists, t is about the least common violation: the best that can be done
until the squeeze is raised. The linear penalty is exact: with rho above the price of a cone, t
stays at zero wherever it can.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tactile_hand_ros.control.optimizer.cones import DIRECTIONS, INSIDE, SIDES, Cones
from tactile_hand_ros.control.optimizer.warm_solver import WarmSolver

Array = NDArray[np.float64]

_PENALTY = 5.0  # rho, relative to the largest weight
_SCALE = 0.3  # of the cost for its largest weight; conditions the dual variables
_TOLERANCE = 1e-5  # from which polishing reaches rounding


class ConeOptimizer:
    """Solves (13) inside friction cones; set up once, warm-started."""

    def __init__(self, weights: Array, minimum: float) -> None:
        """Set up the problem.

        Args:
            weights: Diagonal of W, shape (3k,).
            minimum: Least share f_n of a contact.
        """
        n = len(weights)
        k = n // 3
        self._n, self._k = n, k
        largest = weights.max()
        self._weights = np.append(weights, largest) * (_SCALE / largest)
        self._price = np.append(np.zeros(n), _PENALTY * _SCALE)
        self._fixed = self._fixed_rows()
        m = len(self._fixed)
        self._lower = np.concatenate([np.zeros(6), [1.0], np.full(k, minimum), [0.0]])
        self._lower = np.append(self._lower, np.full(m - len(self._lower), -np.inf))
        self._upper = np.full(m, np.inf)
        self._upper[:7] = self._lower[:7]
        pattern = np.ones_like(self._fixed)
        pattern[6:] = self._fixed[6:] != 0.0
        for i in range(k):
            pattern[self._cone_rows(i), 3 * i : 3 * i + 3] = 1.0
        pattern[:6, n] = 0.0
        self._pattern = sparse.csc_matrix(pattern)
        self._columns = np.repeat(np.arange(n + 1), np.diff(self._pattern.indptr))
        self._solver = WarmSolver(
            sparse.diags(2.0 * self._weights, format="csc"),
            self._price,
            self._pattern.copy(),
            self._lower,
            self._upper,
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            polishing=True,
            warm_starting=True,
            max_iter=2000,
            check_termination=10,
            adaptive_rho_interval=50,
        )

    def _fixed_rows(self) -> Array:
        """Return the constraint rows whose numbers never change, the others as zeros."""
        n, k = self._n, self._k
        rows = np.zeros((8 + k + SIDES * k, n + 1))
        rows[6, 1:n:3] = 1.0
        rows[7 + np.arange(k), 1 + 3 * np.arange(k)] = 1.0
        rows[7 + k, n] = 1.0
        for i in range(k):
            cone = self._cone_rows(i)
            rows[cone, 3 * i] = DIRECTIONS[:, 0]
            rows[cone, 3 * i + 2] = DIRECTIONS[:, 1]
            rows[cone, n] = -1.0
        return rows

    def _cone_rows(self, contact: int) -> slice:
        first = 8 + self._k + SIDES * contact
        return slice(first, first + SIDES)

    def solve(self, balance: Array, cones: Cones) -> tuple[Array, float]:
        """Return f*, shape (k, 3), and the largest violation of the optimality conditions.

        Args:
            balance: G~^T for forces in contact frames, shape (3k, 6).
            cones: Usable friction and load of the contacts.
        """
        n, k = self._n, self._k
        rows = self._fixed.copy()
        rows[:6, :n] = balance.T
        upper = self._upper.copy()
        load = cones.wanted_load
        for i in range(k):
            slope, cone = INSIDE * cones.usable_friction[i], self._cone_rows(i)
            rows[cone, 3 * i + 1] = -slope
            x, normal, z = load[i]
            upper[cone] = slope * normal - DIRECTIONS @ np.array([x, z])
        x, y, _ = self._solver.solve(rows[self._pattern.indices, self._columns], upper)
        if not np.isfinite(x).all() or not np.isfinite(y).all():
            return np.full((k, 3), np.nan), np.inf
        gradient = np.abs(2.0 * self._weights * x + self._price + rows.T @ y).max()
        image = rows @ x
        outside = np.maximum(np.maximum(self._lower - image, image - upper), 0.0).max()
        return x[:n].reshape(k, 3).copy(), float(max(gradient, outside))
