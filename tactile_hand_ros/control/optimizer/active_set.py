# SPDX-License-Identifier: Apache-2.0
"""The optimization (13) solved exactly, by exchanging the lower bounds that are active.

With a set of active bounds, (13) has equalities only, and its optimality conditions

    2 W f + A^T y = 0,   A f = b

are one linear system in y, of size 7 and the number of active bounds: A W^-1 A^T y = -2 b. The set
is the right one when no multiplier pulls at its bound and no other bound is violated; else the
bounds that say so change places (Hintermueller et al., primal-dual active sets, 2003). (13) is
strictly convex: what meets the conditions is the optimum. From the bounds of the last tick on it
takes one system nearly always.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.optimizer.exact import least_cost

Array = NDArray[np.float64]

_ROUNDING = 1e-12  # per largest force or multiplier above 1: no reason to exchange a bound


@compiled
def solve_exactly(
    balance: Array, weights: Array, least: float, held: NDArray[np.bool_]
) -> tuple[Array, Array, int]:
    """Return the optimum f of (13), its multipliers and the number of systems it took.

    Args:
        balance: G~^T, shape (3k, 6).
        weights: Diagonal of W, shape (3k,).
        least: Lower bound of the normal forces.
        held: Bounds to begin with as active, shape (k,); becomes those that are.

    Returns:
        Forces, shape (3k,), and multipliers of balance, sum and lower bounds, shape (7 + k,), of no
        use where the number is 0: then there is no such f, or the bounds do not settle.
    """
    k = len(held)
    x, y = np.zeros(3 * k), np.zeros(7 + k)
    for count in range(1, 2 * k + 2):
        if not _solve_equalities(balance, weights, least, held, x, y):
            if not held.any():
                break
            held[:] = False  # so many active bounds leave nothing free; start without
            continue
        settled = True
        pull = _ROUNDING * max(1.0, np.abs(y).max())
        lift = _ROUNDING * max(1.0, np.abs(x).max())
        for i in range(k):
            pushes, violated = y[7 + i] < pull, x[3 * i + 1] < least - lift
            following = pushes if held[i] else violated
            settled = settled and following == held[i]
            held[i] = following
        if settled:
            return x, y, count
    held[:] = False
    return x, y, 0


@compiled
def _solve_equalities(
    balance: Array, weights: Array, least: float, held: NDArray[np.bool_], x: Array, y: Array
) -> bool:
    """Fill in x and y for a set of active bounds; return whether they are determined."""
    n, k = len(x), len(held)
    active = np.flatnonzero(held)
    size = 7 + len(active)
    rows, right = np.zeros((size, n)), np.zeros(size)
    rows[:6] = balance.T
    rows[6, 1::3], right[6] = 1.0, 1.0
    for i in range(len(active)):
        rows[7 + i, 3 * active[i] + 1], right[7 + i] = 1.0, least
    multipliers, determined = least_cost(rows, right, weights, np.zeros(n), x)
    if not determined:
        return False
    y[7 : 7 + k] = 0.0
    y[:7] = multipliers[:7]
    for i in range(len(active)):
        y[7 + active[i]] = multipliers[7 + i]
    return True
