# SPDX-License-Identifier: Apache-2.0
"""The least cost under equalities alone: what the exact solvers do for each set of active bounds.

    min f^T W f + q^T f  s.t.  A f = b

has the optimality conditions 2 W f + q + A^T y = 0 and A f = b, one linear system in y:
A W^-1 A^T y = -2 b - A W^-1 q.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]


@compiled
def least_cost(
    rows: Array, right: Array, weights: Array, price: Array, x: Array
) -> tuple[Array, bool]:
    """Fill in the optimum; return its multipliers y, and whether both are determined.

    Args:
        rows: A, shape (m, n).
        right: b, shape (m,).
        weights: Diagonal of W, shape (n,).
        price: q, shape (n,).
        x: f, shape (n,).
    """
    size, n = rows.shape
    multipliers = np.zeros(size)
    factor, determined = factorize(schur_complement(rows, weights))
    if not determined:
        return multipliers, False
    missing = _missing(rows, right, weights, price, multipliers, x)
    for _ in range(2):  # the second time removes the rounding errors of the first
        missing *= -2.0
        substitute(factor, missing.reshape(size, 1))
        multipliers += missing
        missing = _missing(rows, right, weights, price, multipliers, x)
    return multipliers, True


@compiled
def _missing(
    rows: Array, right: Array, weights: Array, price: Array, multipliers: Array, x: Array
) -> Array:
    """Fill in the f that belongs to multipliers; return by how much it misses b, shape (m,)."""
    size, n = rows.shape
    for j in range(n):
        total = price[j]
        for i in range(size):
            total += rows[i, j] * multipliers[i]
        x[j] = -0.5 * total / weights[j]
    missing = right.copy()
    for i in range(size):
        for j in range(n):
            missing[i] -= rows[i, j] * x[j]
    return missing


@compiled
def schur_complement(rows: Array, weights: Array) -> Array:
    """Return A W^-1 A^T, of which the upper triangle is filled in."""
    size, n = rows.shape
    out = np.zeros((size, size))
    for i in range(size):
        for j in range(i, size):
            total = 0.0
            for c in range(n):
                total += rows[i, c] * rows[j, c] / weights[c]
            out[i, j] = total
    return out
