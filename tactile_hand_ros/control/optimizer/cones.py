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
        return float(cone_distances(forces + self.load, self.usable_friction).min())


def cone_distances(forces: Array, friction: Array) -> Array:
    """Return the distances of forces inside friction cones, mu f_n - |f_t|, shape (..., k), N.

    Forces in contact frames have the shape (..., k, 3), N, and mu (..., k).
    """
    return np.asarray(friction * forces[..., 1] - np.hypot(forces[..., 0], forces[..., 2]))


@compiled
def reaches(forces: Array, usable_friction: Array) -> Array:
    """Return the distances of forces beyond the sides of the pyramids, shape (k, SIDES).

    They are additive in the forces, in contact frames, shape (k, 3), and not positive inside. A
    ball of loads of radius d reaches d sqrt(1 + mu^2) further than its center.
    """
    beyond = np.empty((len(forces), SIDES))
    for i in range(len(forces)):
        x, n, z = forces[i]
        for j in range(SIDES):
            tangential = DIRECTIONS[j, 0] * x + DIRECTIONS[j, 1] * z
            beyond[i, j] = tangential - INSIDE * usable_friction[i] * n
    return beyond


@compiled
def with_reserve(beyond: Array, usable_friction: Array, reserve: Array) -> Array:
    """Return `reaches`, shape (k, SIDES), with balls of loads around them of radii (k,), N."""
    out = beyond.copy()
    for i in range(len(out)):
        mu = usable_friction[i]
        out[i] += INSIDE * reserve[i] * math.sqrt(1.0 + mu * mu)
    return out


@compiled
def grasp_frames(points: Array, rotations: Array) -> tuple[Array, Array]:
    """Return contact frames whose tangents follow the grasp instead of the palm, (k, 3, 3).

    The second array, of the same shape, turns components of the given frames into those of the new.
    t_z is the normal of the best plane through the contacts, projected on the face. For a finger
    that pushes along that normal it is the direction from the centroid. Pyramids with an even
    number of sides do not depend on the sign of the normal.

    Points are in the palm frame, shape (k, 3), m; the normals of the contact frames are kept.
    """
    arms = centered(points)
    _, axes = np.linalg.eigh(arms.T @ arms)
    plane, area = axes[:, 0].copy(), np.zeros(3)
    for i in range(len(arms)):
        area += np.array(cross(arms[i - 1], arms[i]))
    if plane @ area < 0.0:  # the sign of an eigenvector may change from tick to tick
        plane = -plane
    out, turns = np.empty_like(rotations), np.empty_like(rotations)
    for i in range(len(arms)):
        out[i] = face_frame(rotations[i, :, 1], plane, arms[i])
        turns[i] = out[i].T @ rotations[i]
    return out, turns


@compiled
def followed(
    before: Array, optimum: Array, balance: Array, load: Array, friction: Array, fraction: float
) -> Array:
    """Return f*, shape (k, 3), between the last one, balanced again, and an optimum.

    Args:
        before: f* of the last tick, shape (k, 3).
        optimum: The optimum at this tick, shape (k, 3).
        balance: G~^T at this tick, shape (3k, 6).
        load: Load in contact frames per unit of internal force, shape (k, 3).
        friction: Usable mu, shape (k,).
        fraction: Minimum fraction of the way, 0 to 1.
    """
    start, found = balanced(before, balance)
    if not found:
        return optimum
    fraction = max(fraction, _way_into_cones(start, optimum, load, friction))
    return start + fraction * (optimum - start)


@compiled
def balanced(forces: Array, balance: Array) -> tuple[Array, bool]:
    """Return the nearest forces with G~ f = 0 and sum f_n = 1, and whether they were found.

    Forces are in contact frames, shape (k, 3); `balance` is G~^T, shape (3k, 6).
    """
    rows, flat = np.zeros((7, forces.size)), forces.copy().reshape(-1)
    rows[:6], rows[6, 1::3] = balance.T, 1.0
    excess = rows @ flat
    excess[6] -= 1.0
    u, found = factorize(rows @ rows.T)
    if not found:
        return forces, False
    substitute(u, excess.reshape(-1, 1))
    return (flat - excess @ rows).reshape(forces.shape), True


@compiled
def imbalance(forces: Array, balance: Array) -> float:
    """Return by how much f*, shape (k, 3), violates G~ f = 0 and sum f_n = 1; see `balanced`."""
    missing, total = forces.copy().reshape(-1) @ balance, forces[:, 1].sum()
    return float(max(np.abs(missing).max(), abs(total - 1.0)))


@compiled
def _way_into_cones(start: Array, end: Array, load: Array, friction: Array) -> float:
    """Return the minimum fraction of the way at which the cones start, 1 if they do not."""
    first, last = reaches(start + load, friction).ravel(), reaches(end + load, friction).ravel()
    fraction = 0.0
    for i in range(len(first)):
        if first[i] > 0.0:
            way = first[i] / (first[i] - last[i]) if last[i] < 0.0 else 1.0
            fraction = max(fraction, way)
    return fraction
