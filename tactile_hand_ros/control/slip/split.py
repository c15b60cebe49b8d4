# SPDX-License-Identifier: Apache-2.0
"""The squeeze that contact forces need to stay inside their friction cones."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    net_wrench,
    spread_wrench,
)
from tactile_hand_ros.control.optimizer.cones import INSIDE, Cones, reaches
from tactile_hand_ros.control.slip.reserve import Reserve, ReserveConfig, shift
from tactile_hand_ros.errors import CollinearContactsError
from tactile_hand_ros.jit.compiled import compiled

Array = NDArray[np.float64]

_LEAST_SQUEEZE = 0.1  # N; below, load per squeeze means nothing
_GRAZES = 1e-12  # share by which rounding may miss a double root, as where nothing is tangential
_CLEAR_MARGIN = 1e-2  # collinearity margin from which on f* may be reshaped


class Split(NamedTuple):
    """Contact forces as load and squeeze, all in contact frames.

    Attributes:
        load: Smallest forces with the measured net wrench, shape (k, 3), N.
        squeeze: The rest, which is in balance with itself, shape (k, 3), N.
        grasp_force: Sum of the normal squeezing forces, N.
    """

    load: Array
    squeeze: Array
    grasp_force: float


def split(contacts: Contacts, forces: Array) -> Split:
    """Split measured forces as the law (14) composes them: f = k_f f* + G~^+ w.

    Args:
        contacts: Contact points and frames; all must touch.
        forces: Forces on the object in contact frames, shape (k, 3), N.

    Raises:
        CollinearContactsError: If the contacts lie on a line (A7).
    """
    parts, margin = _measured_split(contacts, forces)
    if margin < MIN_COLLINEARITY_MARGIN:
        raise CollinearContactsError.of(contacts.positions)
    return parts


def _measured_split(contacts: Contacts, forces: Array) -> tuple[Split, float]:
    """Return the split, of no use on a line, and the collinearity margin."""
    load, squeeze, total, margin = _split(contacts.positions, contacts.rotations, forces)
    return Split(load, squeeze, total), margin


@compiled
def _split(points: Array, rotations: Array, forces: Array) -> tuple[Array, Array, float, float]:
    spread, margin = spread_wrench(points, net_wrench(points, rotations, forces))
    load, squeeze, total = np.empty_like(forces), np.empty_like(forces), 0.0
    for i in range(len(forces)):
        r, (x, y, z) = rotations[i], spread[i]
        for axis in range(3):
            load[i, axis] = r[0, axis] * x + r[1, axis] * y + r[2, axis] * z
            squeeze[i, axis] = forces[i, axis] - load[i, axis]
        total += squeeze[i, 1]
    return load, squeeze, total, margin


class ConeWatchConfig(Protocol):
    """Parameters of `ConeWatch`."""

    @property
    def load_time(self) -> float:
        """Time constant of the load, s."""

    @property
    def squeeze_share(self) -> float:
        """Share of the squeeze that is felt with which f* should do."""

    @property
    def reserve(self) -> ReserveConfig:
        """Loads that f* should be ready for."""

    @property
    def load_memory(self) -> float:
        """Time constant with which the loads of the recent past are forgotten, s."""


class ConeWatch:
    """Follows what the contacts carry, slowly enough that noise does not shake f*.

    It remembers the worst of the recent past for each side of the friction pyramids, and f* is made
    for that: a shape that follows a swinging load is always too late for it. Touch that is doubted
    is not followed, and afterwards all begins with the load that is felt then.
    """

    def __init__(self, config: ConeWatchConfig, contacts: int) -> None:
        """Follow the load of k contacts."""
        self._reserve = Reserve(config.reserve, contacts)
        self._doubted = False
        self.configure(config)
        self.reset()

    def reject_touch(self, doubted: bool) -> None:
        """Take whether touch is doubted, see `Controller.touch_rejected`, from the next tick on."""
        if doubted:
            self.reset()
        self._doubted = doubted

    def configure(self, config: ConeWatchConfig) -> None:
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
        """Return what the contacts can bear and carry, per unit of the squeeze that is felt now.

        Args:
            stamp: The tick, ns.
            contacts: Contact points and frames.
            forces: Measured forces in contact frames, shape (k, 3), N.
            usable_friction: mu that each contact may use, shape (k,).

        Returns:
            None where there is no grasp or no squeeze yet, or touch is doubted.
        """
        parts = None if self._doubted else _grasp(contacts, forces)
        if parts is None:
            self._load = self._worst = None  # the past that the reserve follows stays
            return None
        elapsed, share, c = 0.0, 1.0, self._config
        if self._load is not None:
            elapsed = 1e-9 * (stamp - self._stamp)
            share = 1.0 - math.exp(-elapsed / c.load_time)
        before = parts.load if self._load is None else self._load
        radii = self._reserve.step(parts.load, elapsed)
        load = _per_squeeze(before, parts.load, parts.grasp_force, share)
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
    parts, margin = _measured_split(contacts, forces)
    return parts if margin >= _CLEAR_MARGIN and parts.grasp_force >= _LEAST_SQUEEZE else None


@compiled
def _per_squeeze(before: Array, load: Array, grasp_force: float, share: float) -> Array:
    """Return the load per unit of squeeze, smoothed, shape (k, 3).

    Args:
        before: The same at the last tick, shape (k, 3).
        load: What the contacts carry, shape (k, 3), N.
        grasp_force: The squeeze, N.
        share: Share of the way to the present load.
    """
    now = np.empty_like(load)
    for i in range(len(load)):
        for axis in range(3):
            felt, last = load[i, axis] / grasp_force, before[i, axis]
            now[i, axis] = felt if share == 1.0 else last + share * (felt - last)
    return now


@compiled
def _wanted(worst: Array, radii: Array, friction: Array, squeeze: float) -> Array:
    """Return what f* is to be ready for, per unit of squeeze, shape (k, SIDES); see `reaches`.

    Args:
        worst: How far loads of the recent past reach beyond the pyramids, shape (k, SIDES), N.
        radii: Radii of further loads that may come, shape (k,), N.
        friction: Usable mu, shape (k,).
        squeeze: The squeeze with which f* should do, N.
    """
    wanted = np.empty_like(worst)
    for i in range(len(worst)):
        reserve = INSIDE * friction[i] * shift(radii[i], friction[i])
        for j in range(worst.shape[1]):
            wanted[i, j] = (worst[i, j] + reserve) / squeeze
    return wanted


@compiled
def required_squeeze(
    load: tuple[float, float, float], shape: tuple[float, float, float], usable_friction: float
) -> float:
    """Return the least k >= 0 for which load + k shape lies in a friction cone.

    The boundary of the cone |f_t| = mu f_n is quadratic in k.

    Args:
        load: Force of a contact (x, n, z) that does not grow with the squeeze, N.
        shape: Force of the contact per unit squeeze.
        usable_friction: mu of the cone.

    Returns:
        k in N; infinite when no squeeze of this shape puts it there.
    """
    lx, ln, lz = load
    sx, sn, sz = shape
    square = usable_friction * usable_friction
    a = sx * sx + sz * sz - square * sn * sn
    b = lx * sx + lz * sz - square * ln * sn
    c = lx * lx + lz * lz - square * ln * ln
    if c <= 0.0 and ln >= 0.0:
        return 0.0  # the load alone is inside
    inside = b * b - a * c
    if a == 0.0 or inside < -_GRAZES * b * b:
        return math.inf
    # A shape inside the cone (a < 0) enters it at the larger root for good; one outside passes
    # through it from the smaller root on, if at all.
    k = (-b - math.sqrt(max(0.0, inside))) / a
    return k if k >= 0.0 and ln + k * sn >= -_GRAZES * abs(ln) else math.inf
