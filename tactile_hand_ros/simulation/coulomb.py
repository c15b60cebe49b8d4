# SPDX-License-Identifier: Apache-2.0
"""Unilateral contact with Coulomb friction over one step: contacts stick, slip or open.

Let w = W p + b be the velocities of the object against the fingertips after the step, in contact
frames (x, n, z), and p the impulses on the object. Every contact obeys

    Signorini   0 <= p_n,  0 <= w_n + c,  p_n (w_n + c) = 0   (c = gap / h lets an open gap close)
    Coulomb     |p_t| <= mu p_n,  and  p_t = -mu p_n w_t / |w_t|  where w_t != 0

The cone is circular and sticking means w_t = 0 to rounding. Without penetration (c >= 0) a solution
exists for any mu and any singular W; see docs/explanation/physics.md. A penetration (c < 0) cannot
always be removed, since fingers may jam the object. Then it must not grow, which is c = 0. One in a
hundred random problems with a singular W or a huge mu is not solved, and the outcome is UNSOLVED.

A contact may have a fourth component s, the moment about the normal per its lever arm, and the
velocity of turning times that arm. Then p_t and w_t have three components: the limit surface of a
soft fingertip, an ellipsoid (Howe and Cutkosky 1996).

Newton's method finds the root of a function of p that vanishes where the laws hold (Alart and
Curnier 1991).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import Array, compiled

EXACT = 0
"""Outcome: both laws hold."""
RELAXED = 1
"""Outcome: penetrations could not be removed in this step; they do not grow."""
UNSOLVED = 2
"""Outcome: no impulses were found that obey the laws; the ones applied add no energy."""

_TOLERANCE = 1e-10  # of the residual
_ROUNDING = 1e-9  # of the impulse that stops a contact; smaller ones count as open
_EXACT = 1e-14
_MAX_STEPS = 40
_MAX_HALVINGS = 8
_SINGULAR = 1e-13  # of the largest singular value; smaller ones are rounding
_IMMOVABLE = 1e-8  # of the largest diagonal of W, its lower bound
# Retries of Newton's method: factor of r, and number of steps in which friction grows.
_ATTEMPTS = ((1.0, 1), (0.1, 1), (10.0, 1), (1.0, 4), (1.0, 16), (1.0, 64))


class ContactImpulses(NamedTuple):
    """Solution of a contact problem.

    Attributes:
        impulses: Impulses on the object in contact frames (x, n, z) or (x, n, z, s), shape (c, 3)
            or (c, 4), N s.
        velocities: Velocities w of the object against the fingertips after the step, the same
            shape, m/s.
        residual: Largest violation of the two laws, relative to the largest velocity without
            impulses.
        outcome: EXACT, RELAXED or UNSOLVED.
    """

    impulses: Array
    velocities: Array
    residual: float
    outcome: int


@compiled
def solve_contacts(
    delassus: Array, free: Array, closing: Array, friction: Array, guess: Array
) -> ContactImpulses:
    """Solve the contact laws of one step.

    The first trial is sticking of all contacts, by one linear solve. If a force leaves its cone, a
    semi-smooth Newton method finds the modes of all contacts together, with restarts.

    Args:
        delassus: W, shape (3c, 3c) or (4c, 4c), 1/kg, symmetric and positive semidefinite.
        free: b, velocities without contact impulses, shape (3c,) or (4c,), m/s.
        closing: c = gap / h, shape (c,), m/s.
        friction: mu, shape (c,).
        guess: Impulses of the last step, shape (c, 3) or (c, 4), N s.
    """
    d = len(free) // len(friction)
    offset = free.copy()
    offset[1::d] += closing
    factor, regular = factorize(delassus)
    if regular:
        stuck = -offset
        substitute(factor, stuck.reshape(-1, 1))
        if _inside(stuck, friction):
            return _answer(guess.shape, delassus, free, stuck, 0.0, EXACT)
    laws = _contact_laws(delassus, offset, friction)
    best = _newton(laws, guess.copy().reshape(-1), 1.0)
    left = _into_cones(laws, best)
    if not left < _TOLERANCE:
        best, left = _search(laws, best, left)
    if left < _TOLERANCE:
        return _answer(guess.shape, delassus, free, best, left, EXACT)
    if closing.min() < 0.0:
        kept = free.copy()
        kept[1::d] += np.maximum(closing, 0.0)
        other, remains = _search(_contact_laws(delassus, kept, friction), best, np.inf)
        if remains < _TOLERANCE:
            return _answer(guess.shape, delassus, free, other, _residual(laws, other), RELAXED)
    return _answer(guess.shape, delassus, free, _without_gain(delassus, free, best), left, UNSOLVED)


@compiled
def _inside(p: Array, friction: Array) -> bool:
    d = len(p) // len(friction)
    for i in range(len(friction)):
        if not p[d * i + 1] >= 0.0 or _tangential(p, i, d) > friction[i] * p[d * i + 1]:
            return False
    return True


@compiled
def _answer(
    shape: tuple[int, ...], delassus: Array, free: Array, p: Array, left: float, outcome: int
) -> ContactImpulses:
    velocities: Array = delassus @ p + free
    return ContactImpulses(p.reshape(shape), velocities.reshape(shape), left, outcome)


@compiled
def _tangential(p: Array, i: int, d: int) -> float:
    """Return the length of p without its normal component, of contact i with d components."""
    length: float = np.hypot(p[d * i], p[d * i + 2])
    return length if d == 3 else np.hypot(length, p[d * i + 3])


class _Laws(NamedTuple):
    """The contact laws of a step for impulses p, with w = W p + b and d = 3 or 4.

    Attributes:
        delassus: W, shape (dc, dc), 1/kg, symmetric and positive semidefinite.
        offset: b, velocities without contact impulses, closing speeds included, shape (dc,), m/s.
        friction: mu, shape (c,).
        mobility: r > 0, shape (dc,), kg: turns velocities into impulses, without effect on the
            roots.
        size: Impulses that stop the contacts one by one, shape (dc,), N s.
    """

    delassus: Array
    offset: Array
    friction: Array
    mobility: Array
    size: Array


@compiled
def _contact_laws(delassus: Array, offset: Array, friction: Array) -> _Laws:
    """Return the laws with the inverse diagonal of W as mobility."""
    largest = np.diag(delassus).max()
    smallest = _IMMOVABLE * largest if largest > 0.0 else 1.0
    r, d = np.empty(len(offset)), len(offset) // len(friction)
    for x in range(0, len(offset), d):
        tangential = delassus[x, x] + delassus[x + 2, x + 2]
        if d == 4:
            tangential += delassus[x + 3, x + 3]
        r[x : x + d] = 1.0 / max(tangential / (d - 1), smallest)
        r[x + 1] = 1.0 / max(delassus[x + 1, x + 1], smallest)
    return _Laws(delassus, offset, friction, r, r * max(np.abs(offset).max(), 1e-300))


@compiled
def _search(laws: _Laws, best: Array, left: float) -> tuple[Array, float]:
    """Start from zero in several ways; return the best impulses so far and their residual."""
    for stiffness, parts in _ATTEMPTS:
        p = np.zeros(len(laws.offset))
        for part in range(1, parts + 1):
            friction = laws.friction * (part / parts)
            weaker = _Laws(laws.delassus, laws.offset, friction, laws.mobility, laws.size)
            p = _newton(weaker, p, stiffness)
        found = _into_cones(laws, p)
        if found < left:
            best, left = p, found
        if left < _TOLERANCE:
            break
    return best, left


@compiled
def _without_gain(delassus: Array, free: Array, p: Array) -> Array:
    """Return p, shortened if its work p b + p W p / 2 on the two bodies would be positive."""
    work, stopping = float(p @ free), float(p @ (delassus @ p))
    if not work < 0.0:
        return np.zeros(len(p))
    fraction: float = min(1.0, -2.0 * work / max(stopping, 1e-300))
    return fraction * p


@compiled
def _residual(laws: _Laws, p: Array) -> float:
    """Return the largest violation of the laws, per largest velocity without impulses.

    Velocities count where contacts stick and impulses where they are open.
    """
    return float(np.abs(_violation(laws, p, 1.0)).max())


@compiled
def _into_cones(laws: _Laws, p: Array) -> float:
    """Remove rounding errors that leave the cones from p, and return its residual."""
    d = len(p) // len(laws.friction)
    for i in range(len(laws.friction)):
        x, n = d * i, d * i + 1
        if not p[n] > _ROUNDING * laws.size[n]:
            p[x : x + d] = 0.0
        limit, length, push = laws.friction[i] * p[n], _tangential(p, i, d), p[n]
        if length > limit:
            p[x : x + d] *= limit / length
            p[n] = push
    return _residual(laws, p)


@compiled
def _newton(laws: _Laws, p: Array, stiffness: float) -> Array:
    """Return the best iterate of Newton's method from impulses p, shape (dc,), N s.

    The stiffness is a factor of r: if one fails, another may not.
    """
    best, smallest = p, np.inf
    for _ in range(_MAX_STEPS):
        value = _violation(laws, p, stiffness)
        worst = np.abs(value).max()
        if not worst < np.inf:
            break
        before = smallest
        if worst < smallest:
            best, smallest = p, worst
        # Convergence is quadratic, so continue until rounding stops it.
        if smallest < _EXACT or (smallest < _TOLERANCE and worst > 0.1 * before):
            break
        step = np.linalg.lstsq(_slope(laws, p, stiffness), -value, _SINGULAR)[0]
        # Halve the step until the merit falls; take the full step when it never does.
        length, merit = 1.0, value @ value
        following = p + step
        for _ in range(_MAX_HALVINGS):
            trial = p + length * step
            left = _violation(laws, trial, stiffness)
            if left @ left < (1.0 - 1e-4 * length) * merit:
                following = trial
                break
            length *= 0.5
        p = following
    return best


@compiled
def _violation(laws: _Laws, p: Array, stiffness: float) -> Array:
    """Return F(p) / size, which vanishes if both laws hold.

    F_n = p_n - max(0, a_n) and F_t = p_t - proj(a_t) onto the disc of radius mu max(0, a_n), with
    a = p - r w.
    """
    w, b, mu, r, _ = laws
    aim = p - stiffness * r * (w @ p + b)
    out, d = p.copy(), len(p) // len(mu)
    for i in range(len(mu)):
        normal = max(aim[d * i + 1], 0.0)
        radius, length = mu[i] * normal, _tangential(aim, i, d)
        shrink = radius / length if length > radius else 1.0
        for j in range(d):
            out[d * i + j] -= normal if j == 1 else shrink * aim[d * i + j]
    return out / laws.size


@compiled
def _slope(laws: _Laws, p: Array, stiffness: float) -> Array:
    """Return an element of the generalized Jacobian of F / size at p."""
    w, b, mu, mobility, _ = laws
    r = stiffness * mobility
    aim = p - r * (w @ p + b)
    out, d = np.diag(1.0 / laws.size), len(p) // len(mu)
    for i in range(len(mu)):
        x, n = d * i, d * i + 1
        if aim[n] <= 0.0:  # open: all impulses vanish
            continue
        turns = np.empty((d, len(p)))  # derivatives of the aims
        for j in range(d):
            turns[j] = -r[x + j] * w[x + j]
            turns[j, x + j] += 1.0
        length, radius = _tangential(aim, i, d), mu[i] * aim[n]
        if length > radius:  # slip along u
            u, along, spread = aim[x : x + d] / length, np.zeros(len(p)), radius / length
            for j in range(d):
                if j != 1:
                    along += u[j] * turns[j]
            for j in range(d):
                if j != 1:
                    turns[j] = spread * (turns[j] - u[j] * along) + mu[i] * u[j] * turns[1]
        for j in range(d):
            out[x + j] -= turns[j] / laws.size[x + j]
    return out
