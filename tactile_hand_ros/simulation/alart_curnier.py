# SPDX-License-Identifier: Apache-2.0
"""Contact laws as roots of a function, and Newton's method for them (Alart and Curnier 1991)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]

TOLERANCE = 1e-10  # of the residual
_ROUNDING = 1e-9  # of the impulse that stops a contact: an open one would seem to touch
_EXACT = 1e-14
_MAX_STEPS = 40
_MAX_HALVINGS = 8
_SINGULAR = 1e-13  # of the largest pivot: what is less is rounding
_IMMOVABLE = 1e-8  # of the largest diagonal of W: less counts as much


class Laws(NamedTuple):
    """What the impulses p of a step must obey: 0 <= p_n, 0 <= w_n and so on with w = W p + b.

    Attributes:
        delassus: W, shape (3c, 3c), 1/kg, symmetric and positive semidefinite.
        offset: b, velocities without contact impulses, closing speeds included, shape (3c,), m/s.
        friction: mu, shape (c,).
        mobility: r, shape (3c,), kg: turns velocities into impulses; any r > 0 leaves the
            roots where they are.
        size: Impulses that stop the contacts one by one, shape (3c,), N s.
    """

    delassus: Array
    offset: Array
    friction: Array
    mobility: Array
    size: Array


@compiled
def contact_laws(delassus: Array, offset: Array, friction: Array) -> Laws:
    """Return the laws with the inverse diagonal of W as mobility."""
    n = len(offset)
    largest = 0.0
    for i in range(n):
        largest = max(largest, delassus[i, i])
    least = _IMMOVABLE * largest if largest > 0.0 else 1.0
    r = np.empty(n)
    for x in range(0, n, 3):
        tangential = 0.5 * (delassus[x, x] + delassus[x + 2, x + 2])
        r[x] = r[x + 2] = 1.0 / max(tangential, least)
        r[x + 1] = 1.0 / max(delassus[x + 1, x + 1], least)
    return Laws(delassus, offset, friction, r, r * max(np.abs(offset).max(), 1e-300))


@compiled
def residual(laws: Laws, p: Array) -> float:
    """Return the largest violation of the laws, in units of the fastest velocity without impulses.

    It judges velocities where contacts stick and impulses where they are open, so that neither
    huge impulses nor huge velocities hide the other.
    """
    out = np.empty(len(p))
    violation(laws, p, 1.0, out)
    return float(np.abs(out).max())


@compiled
def into_cones(laws: Laws, p: Array) -> float:
    """Bring p exactly into the cones, where it is but for rounding, and return its residual."""
    for i in range(len(laws.friction)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        if not p[n] > _ROUNDING * laws.size[n]:
            p[x] = p[n] = p[z] = 0.0
        limit, length = laws.friction[i] * p[n], np.hypot(p[x], p[z])
        if length > limit:
            p[x], p[z] = p[x] * (limit / length), p[z] * (limit / length)
    return residual(laws, p)


@compiled
def newton(laws: Laws, p: Array, stiffness: float) -> tuple[Array, float]:
    """Return the best iterate of Newton's method from p on, and its residual.

    Args:
        laws: The laws.
        p: Impulses to begin with, shape (3c,), N s.
        stiffness: Factor of r; where one fails, another may not.
    """
    n = len(p)
    value, trial_value, slope = np.empty(n), np.empty(n), np.empty((n, n))
    best, least = p, np.inf
    for _ in range(_MAX_STEPS):
        violation(laws, p, stiffness, value)
        worst = np.abs(value).max()
        if not worst < np.inf:
            break
        before = least
        if worst < least:
            best, least = p, worst
        # Convergence is quadratic: one more step is worth it until rounding stops it.
        if least < _EXACT or (least < TOLERANCE and worst > 0.1 * before):
            break
        _slope(laws, p, stiffness, slope)
        step = eliminate(slope, -value)
        # Halve the step until the merit falls; take the full step when it never does.
        length, merit = 1.0, value @ value
        following = p + step
        for _ in range(_MAX_HALVINGS):
            trial = p + length * step
            violation(laws, trial, stiffness, trial_value)
            if trial_value @ trial_value < (1.0 - 1e-4 * length) * merit:
                following = trial
                break
            length *= 0.5
        p = following
    return best, least


@compiled
def violation(laws: Laws, p: Array, stiffness: float, out: Array) -> None:
    """Write F(p) / size, which vanishes where both laws hold.

    F_n = p_n - max(0, a_n) and F_t = p_t - proj(a_t) onto the disc of radius mu max(0, a_n), with
    a = p - r w.
    """
    w, b, mu, r, size = laws
    aim = p - stiffness * r * (w @ p + b)
    for i in range(len(mu)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        normal = max(aim[n], 0.0)
        radius, length = mu[i] * normal, np.hypot(aim[x], aim[z])
        shrink = radius / length if length > radius else 1.0
        out[x] = (p[x] - shrink * aim[x]) / size[x]
        out[n] = (p[n] - normal) / size[n]
        out[z] = (p[z] - shrink * aim[z]) / size[z]


@compiled
def _slope(laws: Laws, p: Array, stiffness: float, out: Array) -> None:
    """Write an element of the generalised Jacobian of F / size at p."""
    w, b, mu, mobility, unit = laws
    size = len(b)
    r = stiffness * mobility
    aim = p - r * (w @ p + b)
    for i in range(size):
        for j in range(size):
            out[i, j] = 1.0 / unit[i] if i == j else 0.0
    for i in range(len(mu)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        if aim[n] <= 0.0:  # open: all impulses vanish
            continue
        length, radius = np.hypot(aim[x], aim[z]), mu[i] * aim[n]
        for j in range(size):
            dx, dn, dz = -r[x] * w[x, j], -r[n] * w[n, j], -r[z] * w[z, j]
            if j == x:
                dx += 1.0
            elif j == n:
                dn += 1.0
            elif j == z:
                dz += 1.0
            out[n, j] -= dn / unit[n]
            if length <= radius:  # stick
                out[x, j] -= dx / unit[x]
                out[z, j] -= dz / unit[z]
            else:  # slip along u
                ux, uz = aim[x] / length, aim[z] / length
                along = ux * dx + uz * dz
                spread = radius / length
                out[x, j] -= (spread * (dx - ux * along) + mu[i] * ux * dn) / unit[x]
                out[z, j] -= (spread * (dz - uz * along) + mu[i] * uz * dn) / unit[z]


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
