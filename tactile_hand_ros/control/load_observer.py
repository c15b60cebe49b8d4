# SPDX-License-Identifier: Apache-2.0
"""What weighs on the object, seen from the contact forces: the part that (14) leaves to an error.

The law (14) carries a load w_e only by an error e = -w_e / k_p: half a metre for 0.18 kg with Table
I's gains. But the hand feels what it carries. The net contact force is f = m_o a - w_e, so that

    hat w = F(s) f,   F(s) = 1 / (T s + 1),   added to the manipulation wrench K_p e,

turns M a = K_p e + hat w - c v - f (M: the hand's inertia at the object) into

    (M + (1 - F) m_o) a + c v + k_p x = k_p x_d + (1 - F) w_e.

The load is high-passed: a constant one leaves no error, and the hand meets a step after T, not
after it has sagged. The loop is positive feedback of force with gain m_o / (M + m_o) < 1. What it
costs is damping: 1 - F takes m_o T w^2 / (1 + w^2 T^2) at a frequency w, little for short T.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import net_wrench

Array = NDArray[np.float64]


class ObserverConfig(Config):
    """Parameters of the load observer."""

    time: float = param(
        0.0, "time constant T of the observed load, 0 to switch it off", unit="s", live=True, ge=0.0
    )
    force_limit: float = param(20.0, "largest force it carries", unit="N", live=True, ge=0.0)
    torque_limit: float = param(2.0, "largest torque it carries", unit="N m", live=True, ge=0.0)


class LoadObserver:
    """Low-passes the net wrench of the measured contact forces."""

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
        share = 1.0 - math.exp(-dt / config.time)
        touch = contacts.positions, contacts.rotations, forces
        self.wrench = _followed(self.wrench, *touch, share, config.force_limit, config.torque_limit)
        return self.wrench


@compiled
def _followed(
    before: Array,
    points: Array,
    rotations: Array,
    forces: Array,
    share: float,
    force_limit: float,
    torque_limit: float,
) -> Array:
    """Return an observed wrench a share of the way to that of the contacts, where it is finite."""
    measured, out = net_wrench(points, rotations, forces), before.copy()
    if np.isfinite(measured).all():
        out += share * (measured - out)
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
