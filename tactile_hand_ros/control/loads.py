# SPDX-License-Identifier: Apache-2.0
"""What a grasp carries: the load in the measured forces, the reserve, the force that holds.

The law (14) presses with f = k_f f* + G~^+ w: an internal force, which balances itself and grows
with k_f, and a load, which does not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import centered, net_wrench, spread_wrench
from tactile_hand_ros.rotations import cross, dot

Array = NDArray[np.float64]


_GRAZES = 1e-12  # fraction by which rounding may miss a double root, where nothing is tangential


class Split(NamedTuple):
    """Contact forces as load and internal force, all in palm axes.

    Attributes:
        load: Smallest forces with the measured net wrench, shape (k, 3), N.
        internal: The rest, which balances itself, shape (k, 3), N.
        grasp_force: Sum of the normal internal forces, N.
        margin: Collinearity margin of the contacts; on a line the split is of no use.
    """

    load: Array
    internal: Array
    grasp_force: float
    margin: float


@compiled
def split(points: Array, normals: Array, forces: Array) -> Split:
    """Split measured forces as the law (14) composes them: f = k_f f* + G~^+ w.

    Args:
        points: Contact points in the palm frame, shape (k, 3), m.
        normals: Contact normals into the object, palm axes, shape (k, 3).
        forces: Forces on the object, palm axes, shape (k, 3), N.
    """
    arms, wrench = centered(points), np.zeros(6)
    for i in range(len(forces)):
        wrench[:3] += forces[i]
        (a, b, c), (x, y, z) = arms[i], forces[i]
        p, q, r = cross((a, b, c), (x, y, z))
        wrench[3] += p
        wrench[4] += q
        wrench[5] += r
    load, margin = spread_wrench(points, wrench)
    internal, total = forces - load, 0.0
    for i in range(len(forces)):
        total += dot(internal[i], normals[i])
    return Split(load, internal, total, margin)


def split_part(points: Array, normals: Array, forces: Array, held: NDArray[np.bool_]) -> Split:
    """Split the forces of some contacts as `split` does; the others, not in the mask, have none."""
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

    The boundary of the cone |F - n (n.F)| = mu n.F is quadratic in k.

    Args:
        load: Force of a contact that does not grow with the grasp force, shape (3,), N.
        shape: Force of the contact per unit internal force, shape (3,).
        normal: n of the contact into the object, shape (3,), in the axes of the forces.
        usable_friction: mu of the cone.
        support: Normal force that the load may lose, N; see `shift`.

    Returns:
        k in N; infinite when no grasp force of this shape puts it there.
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
    # A shape inside the cone (a < 0) enters it at the larger root for good; one outside passes
    # through it from the smaller root on, if at all.
    k = (-b - math.sqrt(max(0.0, inside))) / a
    return k if k >= 0.0 and lessened + k * sn >= -_GRAZES * abs(lessened) else math.inf


class ReserveConfig(Config):
    """How much more than it measures a grasp is ready for."""

    floor: float = param(
        0.6,
        "force on the object that may come at any time, per weight of a finger: one that starts, "
        "stops or bumps into something loads the object",
        live=True,
        ge=0.0,
    )
    fraction: float = param(
        0.2, "fraction of the largest recent load that may come on top", live=True, ge=0.0, le=2.0
    )


class CarriedLoad(NamedTuple):
    """What a grasp carries and may use: one estimate, for k_f and for f*.

    Attributes:
        load: Forces that do not grow with the grasp force, contact frames, shape (k, 3), N; NaN
            where there is no grasp.
        friction: mu that the contacts may use, the learned one less a margin, shape (k,).
        reserve: Load in any direction that may come on top at each contact, shape (k,), N.
    """

    load: Array
    friction: Array
    reserve: Array


@compiled
def shift(radius: float, friction: float) -> float:
    """Return by how much a cone is moved along its normal for a radius of loads, in N."""
    return radius * math.sqrt(1.0 + 1.0 / (friction * friction))


class ObserverConfig(Config):
    """Parameters of the load observer."""

    time: float = param(
        0.0, "time constant T of the observed load, 0 to switch it off", unit="s", live=True, ge=0.0
    )
    force_limit: float = param(20.0, "largest force it carries", unit="N", live=True, ge=0.0)
    torque_limit: float = param(2.0, "largest torque it carries", unit="N m", live=True, ge=0.0)


class LoadObserver:
    """What weighs on the object, from the contact forces: the part that (14) leaves to an error.

    The law (14) carries a load w_e only by an error e = -w_e / k_p: half a meter for 0.18 kg with
    Table I's gains. But the net contact force is f = m_o a - w_e, so that

        hat w = F(s) f,   F(s) = 1 / (T s + 1),   added to the manipulation wrench K_p e,

    turns M a = K_p e + hat w - c v - f (M: the hand's inertia at the object) into

        (M + (1 - F) m_o) a + c v + k_p x = k_p x_d + (1 - F) w_e.

    The load is high-passed: a constant one leaves no error, and the hand meets a step after T. The
    loop is positive feedback of force with gain m_o / (M + m_o) < 1. It costs damping: 1 - F takes
    m_o T w^2 / (1 + w^2 T^2) at a frequency w, little for short T.
    """

    def __init__(self) -> None:
        """Start without a load."""
        self.wrench = np.zeros(6)

    def reset(self) -> None:
        """Forget the load."""
        self.wrench = np.zeros(6)

    def step(self, config: ObserverConfig, contacts: Contacts, forces: Array, dt: float) -> Array:
        """Return the wrench to carry, about the contact centroid, shape (6,), N and N m.

        Args:
            config: Time constant and limits.
            contacts: Contact points and frames.
            forces: Measured forces in contact frames, shape (k, 3), N.
            dt: Time since the last tick, s.
        """
        if config.time == 0.0:
            return np.zeros(6)
        fraction = 1.0 - math.exp(-dt / config.time)
        touch = contacts.positions, contacts.rotations, forces
        self.wrench = _followed(
            self.wrench, *touch, fraction, config.force_limit, config.torque_limit
        )
        return self.wrench


@compiled
def _followed(
    before: Array,
    points: Array,
    rotations: Array,
    forces: Array,
    fraction: float,
    force_limit: float,
    torque_limit: float,
) -> Array:
    """Return an observed wrench moved towards the measured one where that is finite."""
    measured, out = net_wrench(points, rotations, forces), before.copy()
    if np.isfinite(measured).all():
        out += fraction * (measured - out)
        limit_wrench(out, force_limit, torque_limit)
    return out


@compiled
def limit_wrench(wrench: Array, force_limit: float, torque_limit: float) -> None:
    """Shorten force and torque of a wrench, shape (6,), in place to at most their limits."""
    limit_length(wrench[:3], force_limit)
    limit_length(wrench[3:], torque_limit)


@compiled
def limit_length(vector: Array, limit: float) -> None:
    """Shorten a vector of shape (3,) in place to at most a length."""
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    if length > limit:
        vector *= limit / length
