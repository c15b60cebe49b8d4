# SPDX-License-Identifier: Apache-2.0
"""Friction cones and whether forces lie in them; apart from the solver, whose libraries load long.

Where the optimization needs planes, twelve of them inside the cone stand for it: a pyramid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.contact import Contacts, face_frame, in_palm
from tactile_hand_ros.control.grasp import centered
from tactile_hand_ros.control.loads import (
    LoadMargin,
    LoadMarginConfig,
    Split,
    shift,
    split,
)
from tactile_hand_ros.rotations import cross

Array = NDArray[np.float64]


_MIN_GRASP_FORCE = 0.1  # N; below, the load per unit of internal force means nothing
_CLEAR_MARGIN = 1e-2  # collinearity margin from which on f* may be reshaped

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
        load: Forces that do not grow with the grasp force, per unit of internal force, shape (k,
            3).
        elapsed: Time since the cones before these, s; 0 where there were none.
        wanted: What f* is made for, as `reaches` gives it: the recent past and a reserve, and less
            grasp force than there is; None for the load itself; shape (k, SIDES).
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
        """Return the minimum mu f_n - |f_t| of f* under the load, per unit of internal force."""
        return cone_margin(forces, self.load, self.usable_friction)


@compiled
def cone_margin(forces: Array, load: Array, usable_friction: Array) -> float:
    """Return the minimum mu f_n - |f_t| of forces and load in contact frames, shape (k, 3)."""
    minimum = np.inf
    for i in range(len(forces)):
        x, n, z = forces[i] + load[i]
        minimum = min(minimum, usable_friction[i] * n - math.sqrt(x * x + z * z))
    return minimum


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


@compiled
def grasp_frames(points: Array, rotations: Array) -> Array:
    """Return contact frames whose tangents follow the grasp instead of the palm, (k, 3, 3).

    t_z is the normal of the plane that is nearest to the contacts, projected on the face. Frames
    that follow the palm are undefined where a normal lies along palm z. Here that would be a
    finger that pushes across the plane of all contacts, where its force balances nothing; then its
    direction to their centroid is taken. A pyramid of an even number of sides is the same for
    either sign of the plane's normal.

    Args:
        points: Contact points in the palm frame, shape (k, 3), m.
        rotations: Contact frames, of which the normals are kept, shape (k, 3, 3).
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


class TrackerConfig(Protocol):
    """What a `ConeTracker` takes of the parameters of (13)."""

    reserve: LoadMarginConfig
    load_time: float
    load_memory: float
    squeeze_share: float


class ConeTracker:
    """Follows what the contacts carry, slowly enough that noise does not shake f*.

    It remembers the worst of the recent past for each side of the friction pyramids, and f* is made
    for that: a shape that follows a swinging load is always too late for it. Touch that is doubted
    is not followed, and afterwards all starts with the load that is measured then.
    """

    def __init__(self, config: TrackerConfig, contacts: int, finger_weight: float) -> None:
        """Follow the load of k contacts of fingers with a weight in N."""
        self._reserve = LoadMargin(config.reserve, contacts, finger_weight)
        self._doubted = False
        self.configure(config)
        self.reset()

    def reject_touch(self, doubted: bool) -> None:
        """Take whether touch is doubted, see `Controller.touch_rejected`, from the next tick on."""
        if doubted:
            self.reset()
        self._doubted = doubted

    def configure(self, config: TrackerConfig) -> None:
        """Take other parameters; what is known of the load stays."""
        self._config = config
        self._reserve.configure(config.reserve)

    def reset(self) -> None:
        """Forget everything."""
        self._load: Array | None = None
        self._worst: Array | None = None
        self._reserve.reset()
        self._stamp = 0

    def step(
        self, stamp: int, contacts: Contacts, forces: Array, usable_friction: Array
    ) -> Cones | None:
        """Return what the contacts can bear and carry, per newton of the present grasp force.

        Args:
            stamp: The tick, ns.
            contacts: Contact points and frames.
            forces: Measured forces in contact frames, shape (k, 3), N.
            usable_friction: mu that each contact may use, shape (k,).

        Returns:
            None where there is no grasp or no grasp force yet, or touch is doubted.
        """
        parts = None if self._doubted else _grasp(contacts, forces)
        if parts is None:
            self._load = self._worst = None  # the past that the reserve follows stays
            return None
        elapsed, fraction, c = 0.0, 1.0, self._config
        if self._load is not None:
            elapsed = 1e-9 * (stamp - self._stamp)
            fraction = 1.0 - math.exp(-elapsed / c.load_time)
        before = parts.load if self._load is None else self._load
        radii = self._reserve.step(parts.load, elapsed)
        load = _per_grasp_force(before, parts.load, parts.grasp_force, fraction)
        worst = reaches(parts.grasp_force * load, usable_friction)
        if self._worst is not None:
            keep = math.exp(-elapsed / c.load_memory)
            worst = np.maximum(worst, worst + keep * (self._worst - worst))
        self._load, self._worst, self._stamp = load, worst, stamp
        wanted = _wanted(worst, radii, usable_friction, c.squeeze_share * parts.grasp_force)
        return Cones(usable_friction, load, elapsed, wanted)


def _grasp(contacts: Contacts, forces: Array) -> Split | None:
    """Split the forces where all fingers hold something between them."""
    if not contacts.all_touching:
        return None
    frames = contacts.rotations
    parts = split(contacts.positions, contacts.normals, in_palm(frames, forces, 1.0))
    if parts.margin < _CLEAR_MARGIN or parts.grasp_force < _MIN_GRASP_FORCE:
        return None
    return parts._replace(load=np.einsum("kji,kj->ki", frames, parts.load))


@compiled
def _per_grasp_force(before: Array, load: Array, grasp_force: float, fraction: float) -> Array:
    """Return the load per unit of internal force, smoothed, shape (k, 3).

    Args:
        before: The same at the last tick, shape (k, 3).
        load: What the contacts carry, shape (k, 3), N.
        grasp_force: The grasp force, N.
        fraction: Fraction of the way to the present load.
    """
    now = np.empty_like(load)
    for i in range(len(load)):
        for axis in range(3):
            felt, last = load[i, axis] / grasp_force, before[i, axis]
            now[i, axis] = felt if fraction == 1.0 else last + fraction * (felt - last)
    return now


@compiled
def _wanted(worst: Array, radii: Array, friction: Array, grasp_force: float) -> Array:
    """Return what f* is to be ready for per unit of internal force, (k, SIDES); see `reaches`.

    Args:
        worst: How far loads of the recent past reach beyond the pyramids, shape (k, SIDES), N.
        radii: Radii of further loads that may come, shape (k,), N.
        friction: Usable mu, shape (k,).
        grasp_force: The grasp force with which f* should do, N.
    """
    wanted = np.empty_like(worst)
    for i in range(len(worst)):
        reserve = INSIDE * friction[i] * shift(radii[i], friction[i])
        for j in range(worst.shape[1]):
            wanted[i, j] = (worst[i, j] + reserve) / grasp_force
    return wanted


@compiled
def followed(
    before: Array, optimum: Array, balance: Array, load: Array, friction: Array, fraction: float
) -> tuple[Array, bool]:
    """Return f* on the way from that of the last tick to an optimum, and whether it could be found.

    Args:
        before: f* of the last tick, shape (k, 3).
        optimum: The optimum at this tick, shape (k, 3).
        balance: G~^T at this tick, shape (3k, 6).
        load: Forces that do not grow with the grasp force, per unit of internal force, shape (k,
            3).
        friction: mu as learned, shape (k,).
        fraction: Minimum fraction of the way, 0 to 1.
    """
    start, found = balanced(before, balance)
    fraction = max(fraction, _way_into_cones(start, optimum, load, friction))
    return start + fraction * (optimum - start), found


@compiled
def balanced(forces: Array, balance: Array) -> tuple[Array, bool]:
    """Return the forces nearest to given ones with G~ f = 0 and sum f_n = 1, and whether found."""
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
def imbalance(forces: Array, balance: Array) -> tuple[float, float]:
    """Return the largest component of G~ f and |sum f_n - 1| of forces f, shape (k, 3).

    Args:
        forces: f, shape (k, 3).
        balance: G~^T, shape (3k, 6).
    """
    wrench, total = np.zeros(6), -1.0
    for i in range(len(forces)):
        total += forces[i, 1]
        for axis in range(3):
            for j in range(6):
                wrench[j] += balance[3 * i + axis, j] * forces[i, axis]
    return np.abs(wrench).max(), abs(total)


@compiled
def _way_into_cones(start: Array, end: Array, load: Array, friction: Array) -> float:
    """Return the minimum fraction of a way after which it is inside the cones, 1 if it never is."""
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
