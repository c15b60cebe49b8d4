# SPDX-License-Identifier: Apache-2.0
"""The squeeze that contact forces need to stay inside their friction cones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.cone_optimizer import Cones
from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.grasp import collinearity_margin, net_wrench, wrench_forces

Array = NDArray[np.float64]

_LEAST_SQUEEZE = 0.1  # N; below, load per squeeze means nothing


@dataclass(frozen=True)
class Split:
    """Contact forces as load and squeeze, all in contact frames.

    Attributes:
        load: Smallest forces with the measured net wrench, shape (k, 3), N.
        squeeze: The rest, which is in balance with itself, shape (k, 3), N.
    """

    load: Array
    squeeze: Array

    @property
    def grasp_force(self) -> float:
        """Sum of the normal squeezing forces, N."""
        return float(self.squeeze[:, 1].sum())


def split(contacts: Contacts, forces: Array) -> Split:
    """Split measured forces as the law (14) composes them: f = k_f f* + G~^+ w.

    Args:
        contacts: Contact points and frames; all must touch.
        forces: Forces on the object in contact frames, shape (k, 3), N.

    Raises:
        CollinearContactsError: If the contacts lie on a line (A7).
    """
    load = wrench_forces(contacts.positions, net_wrench(contacts, forces))
    load = (load[:, None, :] @ contacts.rotations)[:, 0, :]
    return Split(load, forces - load)


class ConeWatch:
    """Follows what the contacts carry, slowly enough that noise does not shake f*."""

    def __init__(self, time: float) -> None:
        """Smooth the load with a time constant in s."""
        self._time = time
        self.reset()

    def reset(self) -> None:
        """Forget the load."""
        self._load: Array | None = None
        self._stamp = 0

    def step(self, stamp: int, contacts: Contacts, forces: Array, friction: Array) -> Cones | None:
        """Return what the contacts can bear and carry, per unit of the squeeze that is felt now.

        Args:
            stamp: The tick, ns.
            contacts: Contact points and frames.
            forces: Measured forces in contact frames, shape (k, 3), N.
            friction: mu of each contact, shape (k,).

        Returns:
            None where there is no grasp or no squeeze yet.
        """
        if not contacts.touching.all() or collinearity_margin(contacts.positions) < 1e-2:
            self.reset()
            return None
        parts = split(contacts, forces)
        if parts.grasp_force < _LEAST_SQUEEZE:
            self.reset()
            return None
        load = parts.load / parts.grasp_force
        if self._load is not None:
            share = 1.0 - math.exp(-1e-9 * (stamp - self._stamp) / self._time)
            load = self._load + share * (load - self._load)
        self._load, self._stamp = load, stamp
        return Cones(friction, load)


def required_squeeze(load: Array, shape: Array, friction: float) -> float:
    """Return the least k >= 0 for which load + k shape lies in a friction cone.

    The boundary of the cone |f_t| = mu f_n is quadratic in k.

    Args:
        load: Force of a contact that does not grow with the squeeze, shape (3,), N.
        shape: Force of the contact per unit squeeze, shape (3,).
        friction: mu.

    Returns:
        k in N; infinite when no squeeze of this shape puts it there.
    """
    lx, ln, lz = load.tolist()
    sx, sn, sz = shape.tolist()
    square = friction * friction
    a = sx * sx + sz * sz - square * sn * sn
    b = lx * sx + lz * sz - square * ln * sn
    c = lx * lx + lz * lz - square * ln * ln
    if c <= 0.0 and ln >= 0.0:
        return 0.0  # the load alone is inside
    inside = b * b - a * c
    if a == 0.0 or inside < 0.0:
        return math.inf
    # A shape inside the cone (a < 0) enters it at the larger root for good; one outside passes
    # through it from the smaller root on, if at all.
    k = (-b - math.sqrt(inside)) / a
    return k if k >= 0.0 and ln + k * sn >= 0.0 else math.inf
