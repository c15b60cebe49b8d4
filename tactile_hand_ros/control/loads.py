# SPDX-License-Identifier: Apache-2.0
"""Loads of a grasp: their part of the measured forces, the required k_f, the load observer.

Under the law (14) contact forces are f = k_f f* + G~^+ w. The internal force k_f f* balances itself
and grows with k_f. The load G~^+ w does neither.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, all_finite
from tactile_hand_ros.control.grasp import centered, net_wrench, spread_wrench
from tactile_hand_ros.rotations import cross, dot

_GRAZES = 1e-12  # fraction by which rounding may miss a double root, without tangential forces


class Split(NamedTuple):
    """Contact forces as load and internal force, all in palm axes.

    Attributes:
        load: Smallest forces with the measured net wrench, shape (k, 3), N.
        internal: The rest, which balances itself, shape (k, 3), N.
        grasp_force: Sum of the normal internal forces, N.
        margin: Collinearity margin of the contacts; on a line the split is undefined.
    """

    load: Array
    internal: Array
    grasp_force: float
    margin: float


@compiled
def split(points: Array, normals: Array, forces: Array) -> Split:
    """Return forces on the object, (k, 3), N, as the sum of the law (14): f = k_f f* + G~^+ w.

    Contact points, (k, 3), m, normals into the object and forces are in palm axes.
    """
    arms, wrench = centered(points), np.zeros(6)
    for i in range(len(forces)):
        wrench[:3] += forces[i]
        wrench[3:] += np.array(cross(arms[i], forces[i]))
    load, margin = spread_wrench(points, wrench)
    internal, total = forces - load, 0.0
    for i in range(len(forces)):
        total += dot(internal[i], normals[i])
    return Split(load, internal, total, margin)


def split_part(points: Array, normals: Array, forces: Array, held: NDArray[np.bool_]) -> Split:
    """Return the `split` of contacts in a mask, shape (k,); the parts of the others are zero."""
    if held.all():
        return split(points, normals, forces)
    parts = split(points[held], normals[held], forces[held])
    load, internal = np.zeros_like(forces), np.zeros_like(forces)
    load[held], internal[held] = parts.load, parts.internal
    return parts._replace(load=load, internal=internal)


@compiled
def required_grasp_force(
    load: Array, shape: Array, normal: Array, usable_friction: float, support: float = 0.0
) -> float:
    """Return the minimum k >= 0 for which load + k shape lies in a friction cone.

    The boundary of the cone |F - n (n.F)| = mu n.F is quadratic in k. The load, N, the force per
    unit internal force and the normal n into the object have the shape (3,) and the same axes. The
    load may lose `support` of its normal force, N; see `shift`. k, N, is infinite if no grasp force
    of this shape suffices.
    """
    ln, sn = dot(load, normal), dot(shape, normal)
    lessened, square = ln - support, usable_friction * usable_friction
    a = dot(shape, shape) - sn * sn - square * sn * sn
    b = dot(load, shape) - ln * sn - square * lessened * sn
    c = dot(load, load) - ln * ln - square * lessened * lessened
    if c <= 0.0 and lessened >= 0.0:
        return 0.0  # the load alone is inside
    inside = b * b - a * c
    if a == 0.0 or inside < -_GRAZES * b * b:
        return math.inf
    # A shape inside the cone (a < 0) stays in it from the larger root on. One outside enters it at
    # the smaller root, if at all.
    k = (-b - math.sqrt(max(0.0, inside))) / a
    return k if k >= 0.0 and lessened + k * sn >= -_GRAZES * abs(lessened) else math.inf


class ReserveConfig(Config):
    """Loads beyond the measured one for which a grasp is ready."""

    floor: float = param(
        0.6,
        "force on the object that may appear at any time, per weight of a finger, as when a finger "
        "starts, stops or hits an obstacle",
        live=True,
        ge=0.0,
    )
    fraction: float = param(
        0.2, "additional load, as a fraction of the largest recent one", live=True, ge=0.0, le=2.0
    )


class CarriedLoad(NamedTuple):
    """Estimated load and usable friction of a grasp, for k_f and f*.

    Attributes:
        load: Load in contact frames, shape (k, 3), N; NaN without a grasp.
        friction: Usable mu of each contact, the learned one less a margin, shape (k,).
        reserve: Additional load in any direction for each contact, shape (k,), N.
    """

    load: Array
    friction: Array
    reserve: Array


@compiled
def shift(radius: float, friction: float) -> float:
    """Return how far a cone of a friction mu moves along its normal for a ball of loads, N."""
    return radius * math.sqrt(1.0 + 1.0 / (friction * friction))


class ObserverConfig(Config):
    """Parameters of the load observer."""

    time: float = param(
        0.0, "time constant T of the observed load, 0 to switch it off", unit="s", live=True, ge=0.0
    )
    force_limit: float = param(20.0, "largest force it carries", unit="N", live=True, ge=0.0)
    torque_limit: float = param(2.0, "largest torque it carries", unit="N m", live=True, ge=0.0)


class LoadObserver:
    """Estimates the load on the object from the contact forces.

    The law (14) alone carries a load w_e by an error e = -w_e / k_p. The net contact force of an
    object of mass m_o is f = m_o a - w_e. Adding hat w = F(s) f, F(s) = 1 / (T s + 1), to K_p e
    gives, with the hand's inertia M at the object,

        (M + (1 - F) m_o) a + c v + k_p x = k_p x_d + (1 - F) w_e,

    so that a constant load leaves no error. See docs/explanation/loads.md.
    """

    def __init__(self) -> None:
        """Start without a load."""
        self.wrench = np.zeros(6)

    def step(
        self,
        config: ObserverConfig,
        contacts: Contacts,
        forces: Array,
        dt: float,
        slower: float = 0.0,
    ) -> Array:
        """Return the wrench to carry, about the contact centroid, shape (6,), N and N m.

        Measured forces are in contact frames, (k, 3), N; `dt` is the time since the last tick, s.
        T is `slower`, s, if that is more than the configured time.
        """
        measured = net_wrench(contacts.positions, contacts.rotations, forces)
        if all_finite(measured):
            fraction = 1.0 - math.exp(-dt / max(config.time, slower))
            self.wrench = self.wrench + fraction * (measured - self.wrench)
            limit_wrench(self.wrench, config.force_limit, config.torque_limit)
        return self.wrench


@compiled
def limit_wrench(wrench: Array, force_limit: float, torque_limit: float) -> None:
    """Shorten force, N, and torque, N m, of a wrench in place to their limits."""
    for part, limit in ((wrench[:3], force_limit), (wrench[3:], torque_limit)):
        x, y, z = part
        length = math.sqrt(x * x + y * y + z * z)
        if length > limit:
            part *= limit / length
