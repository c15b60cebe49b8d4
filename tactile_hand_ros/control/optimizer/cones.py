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
        ready_for: The same as f* is made for: with a reserve, and for less squeeze than there is;
            None for the load itself.
    """

    usable_friction: Array
    load: Array
    elapsed: float = 0.0
    ready_for: Array | None = None

    @property
    def wanted_load(self) -> Array:
        """What f* is made for, shape (k, 3)."""
        return self.load if self.ready_for is None else self.ready_for

    def holds(self, forces: Array) -> bool:
        """Return whether forces f* with the reserve lie in the pyramids of the optimization.

        The pyramids rather than the cones, so that f* does not jump where they begin to matter.
        """
        return inside_pyramids(forces, self.wanted_load, self.usable_friction)

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
def inside_pyramids(forces: Array, load: Array, usable_friction: Array) -> bool:
    """Return whether forces and load, both in contact frames, lie in the friction pyramids."""
    for i in range(len(forces)):
        x, n, z = forces[i] + load[i]
        bound = INSIDE * usable_friction[i] * n
        for j in range(SIDES):
            if not DIRECTIONS[j, 0] * x + DIRECTIONS[j, 1] * z <= bound:
                return False
    return True
