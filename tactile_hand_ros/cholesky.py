# SPDX-License-Identifier: Apache-2.0
"""Linear systems with a symmetric positive definite matrix, by Cholesky's U^T U."""

from __future__ import annotations

import math

import numpy as np

from tactile_hand_ros.compiled import Array, compiled

_SINGULAR = 1e-13  # fraction of a pivot that is left when its row depends on those before


@compiled
def factorize(upper: Array) -> tuple[Array, bool]:
    """Return U with U^T U = M, shape (m, m), and whether M is positive definite beyond rounding.

    Only the upper triangle of M counts. Without the latter, U is of no use.
    """
    m = len(upper)
    u = np.zeros((m, m))
    for i in range(m):
        for j in range(i, m):
            total = upper[i, j]
            for c in range(i):
                total -= u[c, i] * u[c, j]
            if i < j:
                u[i, j] = total / u[i, i]
            elif total > _SINGULAR * upper[i, i]:
                u[i, i] = math.sqrt(total)
            else:
                return u, False
    return u, True


@compiled
def substitute(u: Array, right: Array) -> None:
    """Solve U^T U x = b for each column b of `right`, shape (m, n), in place.

    Zeros of U are passed over: where M consists of blocks, U does too.
    """
    m, n = right.shape
    for i in range(m):
        for c in range(i):
            if u[c, i] != 0.0:
                for j in range(n):
                    right[i, j] -= u[c, i] * right[c, j]
        for j in range(n):
            right[i, j] /= u[i, i]
    for i in range(m - 1, -1, -1):
        for c in range(i + 1, m):
            if u[i, c] != 0.0:
                for j in range(n):
                    right[i, j] -= u[i, c] * right[c, j]
        for j in range(n):
            right[i, j] /= u[i, i]
