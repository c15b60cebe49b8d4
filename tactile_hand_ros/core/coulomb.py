# SPDX-License-Identifier: Apache-2.0
"""Unilateral contact with Coulomb friction over one step: which contacts stick, slip or open.

Let w = W p + b be the velocities of the object against the fingertips after the step, in contact
frames (x, n, z), and p the impulses on the object. Every contact obeys

    Signorini   0 <= p_n,  0 <= w_n + c,  p_n (w_n + c) = 0   (c = gap / h lets an open gap close)
    Coulomb     |p_t| <= mu p_n,  and  p_t = -mu p_n w_t / |w_t|  where w_t != 0

The cone is the exact circular one and sticking means w_t = 0 to rounding: nothing creeps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]

_TOLERANCE = 1e-10  # of the residual, relative to the largest impulse
_MAX_NEWTON = 60
_MAX_SWEEPS = 20_000


@dataclass(frozen=True)
class ContactImpulses:
    """Solution of a contact problem.

    Attributes:
        impulses: Impulses on the object in contact frames (x, n, z), shape (c, 3), N s.
        velocities: Velocities w of the object against the fingertips after the step, (c, 3), m/s.
        residual: Largest violation of the two laws, relative to the largest impulse.
    """

    impulses: Array
    velocities: Array
    residual: float


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
    offset = free.copy()
    offset[1::3] += closing
    sticking = _all_stick(delassus, offset)
    if sticking is not None and _inside(sticking, friction):
        return _result(delassus, free, sticking, 0.0)
    problem = _Problem(delassus, offset, friction)
    best, residual = problem.newton(guess.ravel())
    if residual > _TOLERANCE:
        best, residual = min(
            (best, residual), problem.newton(problem.sweep(best)), key=lambda r: r[1]
        )
    return _result(delassus, free, best, residual)


def _result(delassus: Array, free: Array, p: Array, residual: float) -> ContactImpulses:
    return ContactImpulses(p.reshape(-1, 3), (delassus @ p + free).reshape(-1, 3), residual)


def _all_stick(delassus: Array, offset: Array) -> Array | None:
    _, solution, info = lapack.dposv(delassus, -offset)
    return solution if info == 0 else None


def _inside(p: Array, friction: Array) -> bool:
    normal = p[1::3]
    return bool((normal >= 0.0).all() and (np.hypot(p[0::3], p[2::3]) <= friction * normal).all())


class _Problem:
    """One contact problem, as the root of a piecewise smooth function.

    F_n = p_n - max(0, p_n - r_n w_n),  F_t = p_t - proj(p_t - r_t w_t) onto the disc of radius
    mu max(0, p_n - r_n w_n). Any r > 0 has the same roots; the inverse diagonal of W scales them.
    """

    def __init__(self, delassus: Array, offset: Array, friction: Array) -> None:
        self.W, self.b, self.mu = delassus, offset, friction
        self.n = len(offset)
        diagonal = delassus.diagonal()
        tangential = 0.5 * (diagonal[0::3] + diagonal[2::3])
        self.r = np.empty(self.n)
        self.r[1::3] = 1.0 / diagonal[1::3]
        self.r[0::3] = self.r[2::3] = 1.0 / tangential
        self.scale = max(float(np.abs(offset * self.r).max()), 1e-300)

    def newton(self, p: Array) -> tuple[Array, float]:
        """Return the best iterate and its residual."""
        best, best_residual = p, np.inf
        for _ in range(_MAX_NEWTON):
            value, slope = self._function(p)
            residual = float(np.abs(value).max()) / max(float(np.abs(p).max()), self.scale)
            if residual < best_residual:
                best, best_residual = p, residual
            if residual < _TOLERANCE:
                break
            try:
                step = np.asarray(np.linalg.solve(slope, -value), dtype=np.float64)
            except np.linalg.LinAlgError:
                step = np.asarray(np.linalg.lstsq(slope, -value)[0], dtype=np.float64)
            p = self._line_search(p, step, float(value @ value))
        return best, best_residual

    def _line_search(self, p: Array, step: Array, now: float) -> Array:
        """Halve the step until the merit falls; take the full step when it never does."""
        length = 1.0
        for _ in range(6):
            trial = p + length * step
            value = self._value(trial)
            if value @ value < (1.0 - 1e-4 * length) * now:
                return trial
            length *= 0.5
        return p + step

    def _value(self, p: Array) -> Array:
        aim = p - self.r * (self.W @ p + self.b)
        radius = self.mu * np.maximum(aim[1::3], 0.0)
        length = np.hypot(aim[0::3], aim[2::3])
        shrink = np.where(length > radius, radius / np.maximum(length, 1e-300), 1.0)
        out = p - aim
        out[0::3] = p[0::3] - shrink * aim[0::3]
        out[1::3] = p[1::3] - np.maximum(aim[1::3], 0.0)
        out[2::3] = p[2::3] - shrink * aim[2::3]
        return out

    def _function(self, p: Array) -> tuple[Array, Array]:
        """Return F and an element of its generalised Jacobian."""
        rw = self.r[:, None] * self.W
        aim = p - self.r * (self.W @ p + self.b)
        d_aim = np.eye(self.n) - rw  # derivative of aim
        value, slope = p.copy(), np.eye(self.n)
        for i, mu in enumerate(self.mu):
            x, y, z = 3 * i, 3 * i + 1, 3 * i + 2
            if aim[y] <= 0.0:  # open: all impulses vanish
                continue
            value[y] -= aim[y]
            slope[y] -= d_aim[y]
            t = aim[[x, z]]
            length = float(np.hypot(t[0], t[1]))
            radius = float(mu * aim[y])
            if length <= radius:  # stick
                value[[x, z]] -= t
                slope[[x, z]] -= d_aim[[x, z]]
            else:  # slip along u
                u = t / length
                value[[x, z]] -= radius * u
                spread = radius / length * (np.eye(2) - np.outer(u, u))
                slope[[x, z]] -= spread @ d_aim[[x, z]] + mu * np.outer(u, d_aim[y])
        return value, slope

    def sweep(self, p: Array) -> Array:
        """Improve p by projected Gauss-Seidel, contact by contact, with shrinking steps."""
        p = p.copy()
        for _ in range(_MAX_SWEEPS):
            before = p.copy()
            for i, mu in enumerate(self.mu):
                rows = slice(3 * i, 3 * i + 3)
                aim = p[rows] - 0.7 * self.r[rows] * (self.W[rows] @ p + self.b[rows])
                normal = max(aim[1], 0.0)
                length = float(np.hypot(aim[0], aim[2]))
                shrink = min(1.0, mu * normal / length) if length > 0.0 else 1.0
                p[rows] = aim[0] * shrink, normal, aim[2] * shrink
            if np.abs(p - before).max() < 1e-9 * max(np.abs(p).max(), self.scale):
                break
        return p
