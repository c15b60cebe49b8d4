# SPDX-License-Identifier: Apache-2.0
"""Unilateral contact with Coulomb friction over one step: which contacts stick, slip or open.

Let w = W p + b be the velocities of the object against the fingertips after the step, in contact
frames (x, n, z), and p the impulses on the object. Every contact obeys

    Signorini   0 <= p_n,  0 <= w_n + c,  p_n (w_n + c) = 0   (c = gap / h lets an open gap close)
    Coulomb     |p_t| <= mu p_n,  and  p_t = -mu p_n w_t / |w_t|  where w_t != 0

The cone is the exact circular one and sticking means w_t = 0 to rounding: nothing creeps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.compiled import compiled

Array = NDArray[np.float64]

_TOLERANCE = 1e-10  # of the residual, relative to the largest impulse
_MAX_NEWTON = 60
_ROUNDING = 1e-12  # of the largest impulse
_MAX_SWEEPS = 20_000
# Where more contacts share a load than joints can tell apart, W is singular: any split is right.
_REGULARISATION = 1e-13


class ContactImpulses(NamedTuple):
    """Solution of a contact problem.

    Attributes:
        impulses: Impulses on the object in contact frames (x, n, z), shape (c, 3), N s.
        velocities: Velocities w of the object against the fingertips after the step, (c, 3), m/s.
        residual: Largest violation of the two laws, relative to the largest impulse.
    """

    impulses: Array
    velocities: Array
    residual: float


@compiled
def solve_contacts(
    delassus: Array, free: Array, closing: Array, friction: Array, guess: Array
) -> ContactImpulses:
    """Solve the contact laws of one step.

    Sticking of all contacts is tried first, since it needs one linear solve. Where that leaves a
    cone, a semi-smooth Newton method (Alart and Curnier 1991) finds the modes of all contacts
    together; should it stall, projected Gauss-Seidel sweeps bring it near the solution and it
    starts again.

    Args:
        delassus: W, shape (3c, 3c), 1/kg, symmetric and positive definite.
        free: b, velocities without contact impulses, shape (3c,), m/s.
        closing: c = gap / h, shape (c,), m/s.
        friction: mu, shape (c,).
        guess: Impulses of the last step, shape (c, 3), N s.
    """
    w = delassus.copy()
    offset = free.copy()
    for i in range(len(offset)):
        w[i, i] *= 1.0 + _REGULARISATION
    for i in range(len(friction)):
        offset[3 * i + 1] += closing[i]
    best: Array = np.linalg.solve(w, -offset).astype(np.float64)
    residual = 0.0
    if not _inside(best, friction):
        scale = _scaling(w)
        best, residual = _newton(w, offset, friction, scale, guess.copy().reshape(-1))
        if residual > _TOLERANCE:
            swept = _sweep(w, offset, friction, scale, best)
            again, better = _newton(w, offset, friction, scale, swept)
            if better < residual:
                best, residual = again, better
        _open_exactly(best)
    velocities: Array = delassus @ best + free
    return ContactImpulses(best.reshape(-1, 3), velocities.reshape(-1, 3), residual)


@compiled
def _open_exactly(p: Array) -> None:
    """Remove impulses of rounding size: an open contact would seem to touch."""
    least = _ROUNDING * np.abs(p).max()
    for i in range(0, len(p), 3):
        if p[i + 1] <= least:
            p[i] = p[i + 1] = p[i + 2] = 0.0


@compiled
def _inside(p: Array, friction: Array) -> bool:
    for i in range(len(friction)):
        x, n, z = p[3 * i], p[3 * i + 1], p[3 * i + 2]
        if n < 0.0 or x * x + z * z > (friction[i] * n) ** 2:
            return False
    return True


@compiled
def _scaling(w: Array) -> Array:
    """Return r, the inverse diagonal; any r > 0 leaves the roots of F where they are."""
    r = np.empty(len(w))
    for i in range(0, len(w), 3):
        r[i] = r[i + 2] = 2.0 / (w[i, i] + w[i + 2, i + 2])
        r[i + 1] = 1.0 / w[i + 1, i + 1]
    return r


@compiled
def _newton(w: Array, b: Array, mu: Array, r: Array, p: Array) -> tuple[Array, float]:
    """Return the best iterate of Newton's method and its residual."""
    n = len(b)
    value, trial_value, slope = np.empty(n), np.empty(n), np.empty((n, n))
    scale = max(np.abs(b * r).max(), 1e-300)
    best, best_residual = p, np.inf
    for _ in range(_MAX_NEWTON):
        _violation(w, b, mu, r, p, value)
        residual = np.abs(value).max() / max(np.abs(p).max(), scale)
        if residual < best_residual:
            best, best_residual = p, residual
        if residual < _TOLERANCE:
            break
        _slope(w, b, mu, r, p, slope)
        step = np.linalg.solve(slope, -value)
        # Halve the step until the merit falls; take the full step when it never does.
        length, merit = 1.0, value @ value
        following = p + step
        for _ in range(6):
            trial = p + length * step
            _violation(w, b, mu, r, trial, trial_value)
            if trial_value @ trial_value < (1.0 - 1e-4 * length) * merit:
                following = trial
                break
            length *= 0.5
        p = following
    return best, best_residual


@compiled
def _violation(w: Array, b: Array, mu: Array, r: Array, p: Array, out: Array) -> None:
    """Write F(p), which vanishes where both laws hold.

    F_n = p_n - max(0, a_n) and F_t = p_t - proj(a_t) onto the disc of radius mu max(0, a_n), with
    a = p - r w.
    """
    aim = p - r * (w @ p + b)
    for i in range(len(mu)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        normal = max(aim[n], 0.0)
        radius, length = mu[i] * normal, np.hypot(aim[x], aim[z])
        shrink = radius / length if length > radius else 1.0
        out[x] = p[x] - shrink * aim[x]
        out[n] = p[n] - normal
        out[z] = p[z] - shrink * aim[z]


@compiled
def _slope(w: Array, b: Array, mu: Array, r: Array, p: Array, out: Array) -> None:
    """Write an element of the generalised Jacobian of F at p."""
    size = len(b)
    aim = p - r * (w @ p + b)
    for i in range(size):
        for j in range(size):
            out[i, j] = 1.0 if i == j else 0.0
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
            out[n, j] -= dn
            if length <= radius:  # stick
                out[x, j] -= dx
                out[z, j] -= dz
            else:  # slip along u
                ux, uz = aim[x] / length, aim[z] / length
                along = ux * dx + uz * dz
                spread = radius / length
                out[x, j] -= spread * (dx - ux * along) + mu[i] * ux * dn
                out[z, j] -= spread * (dz - uz * along) + mu[i] * uz * dn


@compiled
def _sweep(w: Array, b: Array, mu: Array, r: Array, p: Array) -> Array:
    """Improve p by projected Gauss-Seidel, contact by contact, with shortened steps."""
    p = p.copy()
    scale = max(np.abs(b * r).max(), 1e-300)
    aim = np.empty(3)
    for _ in range(_MAX_SWEEPS):
        moved = 0.0
        for i in range(len(mu)):
            first = 3 * i
            for j in range(3):
                row = first + j
                aim[j] = p[row] - 0.7 * r[row] * (w[row] @ p + b[row])
            normal, length = max(aim[1], 0.0), np.hypot(aim[0], aim[2])
            shrink = min(1.0, mu[i] * normal / length) if length > 0.0 else 1.0
            aim[0], aim[1], aim[2] = aim[0] * shrink, normal, aim[2] * shrink
            for j in range(3):
                moved = max(moved, abs(aim[j] - p[first + j]))
                p[first + j] = aim[j]
        if moved < 1e-9 * max(np.abs(p).max(), scale):
            break
    return p
