# SPDX-License-Identifier: Apache-2.0
"""Unilateral contact with Coulomb friction over one step: which contacts stick, slip or open.

Let w = W p + b be the velocities of the object against the fingertips after the step, in contact
frames (x, n, z), and p the impulses on the object. Every contact obeys

    Signorini   0 <= p_n,  0 <= w_n + c,  p_n (w_n + c) = 0   (c = gap / h lets an open gap close)
    Coulomb     |p_t| <= mu p_n,  and  p_t = -mu p_n w_t / |w_t|  where w_t != 0

The cone is the exact circular one and sticking means w_t = 0 to rounding. Where no gap is negative
(c >= 0) and velocities before the step exist that make b, there always is a solution, whatever mu
and however singular W; see docs/physics.md. A penetration (c < 0) cannot always be left: fingers
may jam the object. Then it may not grow, which is c = 0. One in a hundred arbitrary problems with a
singular W or a huge mu is not solved; the outcome says so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.simulation.alart_curnier import (
    TOLERANCE,
    Laws,
    contact_laws,
    into_cones,
    newton,
    residual,
)

Array = NDArray[np.float64]

EXACT = 0
"""Outcome: both laws hold."""
RELAXED = 1
"""Outcome: penetrations could not be left in this step; they do not grow."""
UNSOLVED = 2
"""Outcome: no impulses were found that obey the laws; those applied take energy and add none."""

_STIFFNESSES = (1.0, 0.1, 10.0)
_FRICTION_PARTS = (4, 16, 64)  # steps in which friction grows to its value


class ContactImpulses(NamedTuple):
    """Solution of a contact problem.

    Attributes:
        impulses: Impulses on the object in contact frames (x, n, z), shape (c, 3), N s.
        velocities: Velocities w of the object against the fingertips after the step, (c, 3), m/s.
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

    Sticking of all contacts is tried first, since it needs one linear solve. Where that leaves a
    cone, a semi-smooth Newton method (Alart and Curnier 1991) finds the modes of all contacts
    together; where it fails, it starts again elsewhere. What counts is the residual of the laws.

    Args:
        delassus: W, shape (3c, 3c), 1/kg, symmetric and positive semidefinite.
        free: b, velocities without contact impulses, shape (3c,), m/s.
        closing: c = gap / h, shape (c,), m/s.
        friction: mu, shape (c,).
        guess: Impulses of the last step, shape (c, 3), N s.
    """
    offset = free.copy()
    for i in range(len(friction)):
        offset[3 * i + 1] += closing[i]
    factor, regular = factorize(delassus)
    if regular:
        stuck = -offset
        substitute(factor, stuck.reshape(-1, 1))
        if _inside(stuck, friction):
            return _answer(delassus, free, stuck, 0.0, EXACT)
    laws = contact_laws(delassus, offset, friction)
    best, _ = newton(laws, guess.copy().reshape(-1), 1.0)
    left = into_cones(laws, best)
    if not left < TOLERANCE:
        best, left = _search(laws, best, left)
    if left < TOLERANCE:
        return _answer(delassus, free, best, left, EXACT)
    if closing.min() < 0.0:
        kept = free.copy()
        for i in range(len(friction)):
            kept[3 * i + 1] += max(closing[i], 0.0)
        relaxed = contact_laws(delassus, kept, friction)
        other, remains = _search(relaxed, best, np.inf)
        if remains < TOLERANCE:
            return _answer(delassus, free, other, residual(laws, other), RELAXED)
    return _answer(delassus, free, _without_gain(laws, best), left, UNSOLVED)


@compiled
def _search(laws: Laws, best: Array, left: float) -> tuple[Array, float]:
    """Start Newton's method from zero: with other factors of r, then with friction that grows.

    Args:
        laws: The laws.
        best: Impulses known so far, shape (3c,), N s.
        left: Their residual.

    Returns:
        The impulses with the smallest residual that were found, shape (3c,), N s, and the residual.
    """
    n = len(laws.offset)
    for stiffness in _STIFFNESSES:
        p, _ = newton(laws, np.zeros(n), stiffness)
        found = into_cones(laws, p)
        if found < left:
            best, left = p, found
        if left < TOLERANCE:
            return best, left
    for parts in _FRICTION_PARTS:
        p = np.zeros(n)
        for part in range(1, parts + 1):
            friction = laws.friction * (part / parts)
            weaker = Laws(laws.delassus, laws.offset, friction, laws.mobility, laws.size)
            p, _ = newton(weaker, p, 1.0)
        found = into_cones(laws, p)
        if found < left:
            best, left = p, found
        if left < TOLERANCE:
            break
    return best, left


@compiled
def _without_gain(laws: Laws, p: Array) -> Array:
    """Return p, shortened where its work p b + p W p / 2 on the two bodies would be positive."""
    work, stopping = float(p @ laws.offset), float(p @ (laws.delassus @ p))
    if not work < 0.0:
        return np.zeros(len(p))
    fraction: float = min(1.0, -2.0 * work / max(stopping, 1e-300))
    return fraction * p


@compiled
def _answer(delassus: Array, free: Array, p: Array, left: float, outcome: int) -> ContactImpulses:
    velocities: Array = delassus @ p + free
    return ContactImpulses(p.reshape(-1, 3), velocities.reshape(-1, 3), left, outcome)


@compiled
def _inside(p: Array, friction: Array) -> bool:
    for i in range(len(friction)):
        x, n, z = p[3 * i], p[3 * i + 1], p[3 * i + 2]
        if not n >= 0.0 or x * x + z * z > (friction[i] * n) ** 2:
            return False
    return True
