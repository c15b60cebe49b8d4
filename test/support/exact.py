# SPDX-License-Identifier: Apache-2.0
"""Slow, independent solvers for the problems that the core solves fast."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from support.grasps import balance_in_frames
from tactile_hand_ros.control.contact import Contacts

Array = NDArray[np.float64]


def best_forces(contacts: Contacts, weights: Array, minimum: float = 0.0) -> Array | None:
    """Solve (13) by trying every set of active bounds; None if no forces balance.

    For each set the equality-constrained problem has a closed form. The feasible answer with the
    lowest cost is the optimum, since (13) is convex.
    """
    k = len(contacts.positions)
    pushes = np.kron(np.eye(k), [0.0, 1.0, 0.0])  # picks each f_n
    equalities = np.vstack([balance_in_frames(contacts), pushes.sum(axis=0)])
    best, lowest = None, np.inf
    for count in range(k):
        for held in combinations(range(k), count):
            rows = np.vstack([equalities, pushes[list(held)]])
            right = np.concatenate([np.zeros(6), [1.0], np.full(count, minimum)])
            # min |sqrt(W) f| subject to rows f = right is a least-norm problem.
            scaled = rows / np.sqrt(weights)
            forces = np.linalg.lstsq(scaled, right, rcond=1e-11)[0] / np.sqrt(weights)
            if np.abs(rows @ forces - right).max() > 1e-9 * max(1.0, np.abs(forces).max()):
                continue
            cost = float(forces @ (weights * forces))
            if (pushes @ forces >= minimum - 1e-10).all() and cost < lowest - 1e-12 * abs(cost):
                best, lowest = forces.reshape(k, 3), cost
    return best


def contact_law_violation(
    delassus: Array, free: Array, closing: Array, friction: Array, impulses: Array
) -> float:
    """Return the relative violation of Signorini's and Coulomb's laws, 0 for none.

    Written from the laws, not from any residual that a solver minimizes.
    """
    velocities = (delassus @ impulses.ravel() + free).reshape(-1, 3)
    normal, opening = impulses[:, 1], velocities[:, 1] + closing
    push, slide = impulses[:, [0, 2]], velocities[:, [0, 2]]
    impulse = max(float(np.abs(impulses).max()), 1e-12)
    speed = max(float(np.abs(free).max()), float(np.abs(velocities).max()), 1e-12)
    rubbing = np.hypot(*push.T) - friction * normal
    against = np.hypot(*slide.T)[:, None] * push + (friction * normal)[:, None] * slide
    return max(
        float(-normal.min()) / impulse,
        float(-opening.min()) / speed,
        float(np.abs(normal * opening).max()) / (impulse * speed),
        float(rubbing.max()) / impulse,
        float(np.abs(against).max()) / (impulse * speed * max(1.0, float(friction.max()))),
        0.0,
    )


def nearest_point(corners: Array, point: Array) -> Array:
    """Return the nearest point of a convex hull, shape (3,), of corners, shape (v, 3).

    Source: Lawson and Hanson, Solving Least Squares Problems, 1974, section 23.4 (LDP by NNLS).
    """
    arms = (corners - point).T
    weights, _ = nnls(np.vstack([arms, np.ones(len(corners))]), [0.0, 0.0, 0.0, 1.0])
    return point + arms @ weights / weights.sum()
