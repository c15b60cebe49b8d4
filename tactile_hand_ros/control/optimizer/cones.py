# SPDX-License-Identifier: Apache-2.0
"""Friction cones and whether forces lie in them; apart from the solver, whose libraries load long.

Where the optimization needs planes, twelve of them inside the cone stand for it: a pyramid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.compiled import compiled

Array = NDArray[np.float64]

SIDES = 12
"""Sides of a pyramid."""

_ANGLES = 2.0 * np.pi * np.arange(SIDES) / SIDES

DIRECTIONS = np.array([np.cos(_ANGLES), np.sin(_ANGLES)]).T
"""Tangential directions in which the sides face, shape (SIDES, 2)."""

INSIDE = math.cos(math.pi / SIDES)
"""Slope of a pyramid's sides, per mu."""


@dataclass(frozen=True)
class Cones:
    """What the contacts can bear and what they carry.

    Attributes:
        usable_friction: mu that each contact may use: the learned one less a margin, shape (k,).
        load: Forces that do not grow with the squeeze, per unit of squeeze, shape (k, 3).
        elapsed: Time since the cones before these, s; 0 where there were none.
        wanted: What f* is made for, as `reaches` gives it: the recent past and a reserve, and less
            squeeze than there is; None for the load itself; shape (k, SIDES).
    """

    usable_friction: Array
    load: Array
    elapsed: float = 0.0
    wanted: Array | None = None

    @property
    def goal(self) -> Array:
        """What f* is made for, as `reaches` gives it, shape (k, SIDES)."""
        return reaches(self.load, self.usable_friction) if self.wanted is None else self.wanted

    def holds(self, forces: Array) -> bool:
        """Return whether forces f* under all that is wanted lie in the pyramids.

        The pyramids rather than the cones, so that f* does not jump where they begin to matter.
        """
        return bool((reaches(forces, self.usable_friction) + self.goal <= 0.0).all())

    def margin(self, forces: Array) -> float:
        """Return the least mu f_n - |f_t| of forces f* under the load, per unit of squeeze."""
        return cone_margin(forces, self.load, self.usable_friction)


@compiled
def cone_margin(forces: Array, load: Array, usable_friction: Array) -> float:
    """Return the least mu f_n - |f_t| of forces and load, both in contact frames, shape (k, 3)."""
    least = np.inf
    for i in range(len(forces)):
        x, n, z = forces[i] + load[i]
        least = min(least, usable_friction[i] * n - math.sqrt(x * x + z * z))
    return least


@compiled
def reaches(forces: Array, usable_friction: Array) -> Array:
    """Return how far forces reach beyond each side of the friction pyramids, shape (k, SIDES).

    That of a sum is the sum of those of its parts. Not positive means inside.
    """
    beyond = np.empty((len(forces), SIDES))
    for i in range(len(forces)):
        x, n, z = forces[i]
        for j in range(SIDES):
            tangential = DIRECTIONS[j, 0] * x + DIRECTIONS[j, 1] * z
            beyond[i, j] = tangential - INSIDE * usable_friction[i] * n
    return beyond
