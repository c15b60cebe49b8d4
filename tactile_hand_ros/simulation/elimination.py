# SPDX-License-Identifier: Apache-2.0
"""Small linear systems that may be singular, by Gaussian elimination with full pivoting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]

_SINGULAR = 1e-13  # of the largest pivot: what is less is rounding


@compiled
def eliminate(matrix: Array, right: Array) -> Array:
    """Solve a system of n equations; both arguments are overwritten.

    Where the matrix is singular, the unknowns that the other equations leave free are zero.

    Args:
        matrix: Shape (n, n).
        right: Shape (n,).

    Returns:
        The unknowns, shape (n,).
    """
    n = len(right)
    order = np.arange(n)
    rank, first = n, 0.0
    for i in range(n):
        row, column, largest = i, i, 0.0
        for a in range(i, n):
            for b in range(i, n):
                if abs(matrix[a, b]) > largest:
                    row, column, largest = a, b, abs(matrix[a, b])
        first = max(first, largest)
        if not largest > _SINGULAR * first:
            rank = i
            break
        for b in range(n):
            matrix[i, b], matrix[row, b] = matrix[row, b], matrix[i, b]
        right[i], right[row] = right[row], right[i]
        for a in range(n):
            matrix[a, i], matrix[a, column] = matrix[a, column], matrix[a, i]
        order[i], order[column] = order[column], order[i]
        for a in range(i + 1, n):
            share = matrix[a, i] / matrix[i, i]
            if share != 0.0:
                right[a] -= share * right[i]
                for b in range(i + 1, n):
                    matrix[a, b] -= share * matrix[i, b]
    out = np.zeros(n)
    for i in range(rank - 1, -1, -1):
        total = right[i]
        for b in range(i + 1, rank):
            total -= matrix[i, b] * out[order[b]]
        out[order[i]] = total / matrix[i, i]
    return out
