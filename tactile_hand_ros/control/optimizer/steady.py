# SPDX-License-Identifier: Apache-2.0
"""f* from tick to tick: it follows the optimum steadily, and at once where a cone asks for it.

Inside active cones a small change of the felt contacts or of the load changes the optimum up to
thirty times as much. Noise of the skin would so shake the squeeze at every tick, as sliding shakes
a contact: the slip detector could not distinguish the two. So f* goes only a share of the way
to each new optimum, the one that its time constant gives for the time since the last tick, and as
far as it takes to be inside the cones of the friction that was learned, which are a little wider
than those of the optimization.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.optimizer.cones import DIRECTIONS, INSIDE, SIDES

Array = NDArray[np.float64]


@compiled
def followed(
    before: Array, optimum: Array, balance: Array, load: Array, friction: Array, share: float
) -> tuple[Array, bool]:
    """Return f* on the way from that of the last tick to an optimum, and whether it could be found.

    Args:
        before: f* of the last tick, shape (k, 3).
        optimum: The optimum at this tick, shape (k, 3).
        balance: G~^T at this tick, shape (3k, 6).
        load: Forces that do not grow with the squeeze, per unit of squeeze, shape (k, 3).
        friction: mu as learned, shape (k,).
        share: Least share of the way, 0 to 1.
    """
    start, found = balanced(before, balance)
    share = max(share, _way_into_cones(start, optimum, load, friction))
    return start + share * (optimum - start), found


@compiled
def balanced(forces: Array, balance: Array) -> tuple[Array, bool]:
    """Return the forces nearest to given ones with G~ f = 0 and sum f_n = 1, and whether found."""
    n = forces.size
    rows, excess = np.zeros((7, n)), np.zeros((7, 1))
    rows[:6] = balance.T
    excess[6, 0] = -1.0
    flat = forces.copy().reshape(n)
    for i in range(1, n, 3):
        rows[6, i] = 1.0
    for a in range(7):
        for i in range(n):
            excess[a, 0] += rows[a, i] * flat[i]
    u, found = factorize(rows @ rows.T)
    if not found:
        return forces, False
    substitute(u, excess)
    for i in range(n):
        for a in range(7):
            flat[i] -= rows[a, i] * excess[a, 0]
    return flat.reshape(forces.shape), True


@compiled
def imbalance(forces: Array, balance: Array) -> tuple[float, float]:
    """Return the largest component of G~ f and |sum f_n - 1| of forces f, shape (k, 3).

    Args:
        forces: f, shape (k, 3).
        balance: G~^T, shape (3k, 6).
    """
    wrench, total = np.zeros(6), -1.0
    for i in range(len(forces)):
        total += forces[i, 1]
        for axis in range(3):
            for j in range(6):
                wrench[j] += balance[3 * i + axis, j] * forces[i, axis]
    return np.abs(wrench).max(), abs(total)


@compiled
def _way_into_cones(start: Array, end: Array, load: Array, friction: Array) -> float:
    """Return the least share of a way after which it is inside the cones, 1 if it never is."""
    share = 0.0
    for i in range(len(start)):
        slope = INSIDE * friction[i]
        (x, n, z), (a, b, c) = start[i] + load[i], end[i] + load[i]
        for j in range(SIDES):
            p, q = DIRECTIONS[j, 0], DIRECTIONS[j, 1]
            first, last = p * x + q * z - slope * n, p * a + q * c - slope * b
            if first > 0.0:
                share = max(share, first / (first - last) if last < 0.0 else 1.0)
    return share
