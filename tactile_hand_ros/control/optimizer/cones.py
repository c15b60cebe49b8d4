# SPDX-License-Identifier: Apache-2.0
"""Friction cones, and whether forces lie in them, without the solver, which loads slowly.

The optimization replaces each cone by a pyramid of twelve planes inside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import face_frame
from tactile_hand_ros.control.grasp import centered
from tactile_hand_ros.rotations import cross

SIDES = 12
"""Sides of a pyramid."""

_ANGLES = 2.0 * np.pi * np.arange(SIDES) / SIDES

DIRECTIONS = np.array([np.cos(_ANGLES), np.sin(_ANGLES)]).T
"""Tangential directions of the sides, shape (SIDES, 2)."""

INSIDE = math.cos(math.pi / SIDES)
"""Slope of a pyramid's sides, per mu."""


@dataclass(frozen=True)
class Cones:
    """Friction and load of the contacts.

    Attributes:
        usable_friction: Usable mu, the learned one less a margin, shape (k,).
        load: Load in contact frames per unit of internal force, shape (k, 3).
        elapsed: Time since the last cones, s; 0 without any.
        wanted: Loads for which f* is optimized, in the form of `reaches`, shape (k, SIDES): the
            recent past and a reserve at a lower grasp force; None for the present load.
    """

    usable_friction: Array
    load: Array
    elapsed: float = 0.0
    wanted: Array | None = None

    @property
    def goal(self) -> Array:
        """Loads for which f* is optimized, in the form of `reaches`, shape (k, SIDES)."""
        return reaches(self.load, self.usable_friction) if self.wanted is None else self.wanted

    def holds(self, forces: Array) -> bool:
        """Return whether f*, shape (k, 3), under the loads of `goal` lies in the pyramids.

        Pyramids instead of cones avoid a jump of f* at the start of the optimization.
        """
        return bool((reaches(forces, self.usable_friction) + self.goal <= 0.0).all())

    def margin(self, forces: Array) -> float:
        """Return the minimum mu f_n - |f_t| of f*, shape (k, 3), under the load."""
        return cone_margin(forces, self.load, self.usable_friction)


@compiled
def cone_margin(forces: Array, load: Array, usable_friction: Array) -> float:
    """Return the minimum mu f_n - |f_t| of forces and load in contact frames, in their unit."""
    minimum = np.inf
    for i in range(len(forces)):
        x, n, z = forces[i] + load[i]
        minimum = min(minimum, usable_friction[i] * n - math.sqrt(x * x + z * z))
    return minimum


@compiled
def reaches(forces: Array, usable_friction: Array) -> Array:
    """Return the distances of forces beyond the sides of the pyramids, shape (k, SIDES).

    They are additive in the forces, and not positive inside. A ball of loads of radius d reaches
    d sqrt(1 + mu^2) further than its center.

    Args:
        forces: In contact frames, shape (k, 3).
        usable_friction: mu, shape (k,).
    """
    beyond = np.empty((len(forces), SIDES))
    for i in range(len(forces)):
        x, n, z = forces[i]
        for j in range(SIDES):
            tangential = DIRECTIONS[j, 0] * x + DIRECTIONS[j, 1] * z
            beyond[i, j] = tangential - INSIDE * usable_friction[i] * n
    return beyond


@compiled
def grasp_frames(points: Array, rotations: Array) -> Array:
    """Return contact frames whose tangents follow the grasp instead of the palm, (k, 3, 3).

    t_z is the normal of the best plane through the contacts, projected on the face. For a finger
    that pushes along that normal it is the direction from the centroid. Pyramids with an even
    number of sides do not depend on the sign of the normal.

    Args:
        points: Contact points in the palm frame, shape (k, 3), m.
        rotations: Contact frames, whose normals are kept, shape (k, 3, 3).
    """
    arms = centered(points)
    _, axes = np.linalg.eigh(arms.T @ arms)
    plane, area = axes[:, 0].copy(), np.zeros(3)
    for i in range(len(arms)):
        area += np.array(cross(arms[i - 1], arms[i]))
    if plane @ area < 0.0:  # the sign of an eigenvector may change from tick to tick
        plane = -plane
    out = np.empty_like(rotations)
    for i in range(len(arms)):
        out[i] = face_frame(rotations[i, :, 1], plane, arms[i])
    return out


@compiled
def followed(
    before: Array, optimum: Array, balance: Array, load: Array, friction: Array, fraction: float
) -> tuple[Array, bool]:
    """Return f*, shape (k, 3), between the last one and an optimum, and whether it was found.

    Args:
        before: f* of the last tick, shape (k, 3).
        optimum: The optimum at this tick, shape (k, 3).
        balance: G~^T at this tick, shape (3k, 6).
        load: Load in contact frames per unit of internal force, shape (k, 3).
        friction: Usable mu, shape (k,).
        fraction: Minimum fraction of the way, 0 to 1.
    """
    start, found = balanced(before, balance)
    fraction = max(fraction, _way_into_cones(start, optimum, load, friction))
    return start + fraction * (optimum - start), found


@compiled
def balanced(forces: Array, balance: Array) -> tuple[Array, bool]:
    """Return the nearest forces with G~ f = 0 and sum f_n = 1, and whether they were found.

    Args:
        forces: In contact frames, shape (k, 3).
        balance: G~^T, shape (3k, 6).
    """
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
def _way_into_cones(start: Array, end: Array, load: Array, friction: Array) -> float:
    """Return the minimum fraction of the way at which the cones start, 1 if they do not."""
    fraction = 0.0
    for i in range(len(start)):
        slope = INSIDE * friction[i]
        (x, n, z), (a, b, c) = start[i] + load[i], end[i] + load[i]
        for j in range(SIDES):
            p, q = DIRECTIONS[j, 0], DIRECTIONS[j, 1]
            first, last = p * x + q * z - slope * n, p * a + q * c - slope * b
            if first > 0.0:
                fraction = max(fraction, first / (first - last) if last < 0.0 else 1.0)
    return fraction
