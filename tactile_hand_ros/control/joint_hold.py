# SPDX-License-Identifier: Apache-2.0
"""The hold of joints without commands: brake, keep the squeeze, stay, and squeeze with the load.

From joint states and a model of the hand alone. The contacts press on the joints with J_h^T f_c,
which equation (3) gives from what is known, over the last n ticks of length T:

    tau_c = mean(tau) - M_h (theta'_n - theta'_0) / (n T) - (C_h theta' + N_h).

The hold keeps that torque, and nothing else of the last command: no drive and no damping. With the
posture q(t) that brings the joints from theta_0, theta'_0 to rest it answers

    tau = tau_c + (s - 1) J^T f_int + C_h theta' + N_h
          + M_h (q'' + 2 w (q' - theta') + w^2 (q - theta)).

f_int is the part of the tip forces that only squeezes; s grows with the load on the tips. See
docs/safe_hold.md for the derivation and what it was measured to do.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.kinematics import Fingertips

Array = NDArray[np.float64]

FELT_TIME = 0.005
"""Time over which the torque of the contacts is averaged [s]."""

LEAST_SQUEEZE = 0.05
"""Fingers that press less in all do not squeeze [N]."""

_FASTEST = 0.25  # largest w T: the hold stays damped with a tick of delay, see docs/safe_hold.md


class JointHoldConfig(Config):
    """How joints are held while there is no command for them."""

    bandwidth: float = param(
        100.0, "stiffness w: the joints return like w^2 M_h", unit="rad/s", gt=0.0, le=1e4
    )
    stopping_time: float = param(
        0.006, "time constant with which moving joints come to rest", unit="s", gt=0.0, le=1.0
    )
    reserve: float = param(0.2, "share by which the squeeze is raised at once", ge=0.0, le=2.0)
    friction: float = param(
        0.2, "friction that load is assumed to have which comes during the hold", gt=0.0, le=10.0
    )
    squeeze_limit: float = param(
        40.0, "sum of squeezing forces above which the hold adds none", unit="N", ge=0.0, le=1e4
    )


class JointTerms(NamedTuple):
    """What the hand's model says of a posture.

    Attributes:
        tips: Fingertip centres and Jacobians.
        inertia: M_h, shape (m, m).
        bias: C_h theta' + N_h, shape (m,), N m.
    """

    tips: Fingertips
    inertia: Array
    bias: Array


class JointHold:
    """Holds the joints from joint states alone; `engage` at the first tick, `step` at each."""

    def __init__(self, config: JointHoldConfig, hand: Hand, tick: float) -> None:
        """Take the model.

        Args:
            config: Stiffness, braking and squeeze.
            hand: Model of the hand, with gravity.
            tick: Time between two calls of `step`, s.
        """
        self._config, self._hand, self._tick = config, hand, tick
        self._bandwidth = min(config.bandwidth, _FASTEST / tick)

    def engage(self, theta: Array, rates: Array, pressed: Array) -> None:
        """Hold from now on.

        Args:
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            pressed: Torque tau_c with which the contacts press, shape (m,), N m.
        """
        self._pressed = self._felt = pressed.copy()
        tips = self._hand.fingertips(theta)
        self._load, internal = split_forces(tip_forces(tips, pressed))
        self._squeezing = float(np.linalg.norm(internal, axis=1).sum())
        self._squeeze = joint_torque(tips, internal)
        self._most = self._largest_factor()
        self._factor = min(1.0 + self._config.reserve, self._most)
        self.brake(theta, rates)

    def _largest_factor(self) -> float:
        """Return s at the limit of the squeeze or of a joint, at least 1."""
        if self._squeezing < LEAST_SQUEEZE:
            return 1.0
        room = self._hand.effort_limits - np.abs(self._pressed)
        moved = np.abs(self._squeeze)
        joints = room[moved > 0.0] / moved[moved > 0.0]
        factors = [
            self._config.squeeze_limit / self._squeezing,
            1.0 + float(np.min(joints, initial=np.inf)),
        ]
        return max(1.0, min(factors))

    def brake(self, theta: Array, rates: Array) -> None:
        """Come to rest from this posture and these rates, with the squeeze as it is."""
        self._start, self._speed, self._ticks = theta.copy(), rates.copy(), 0

    def step(self, theta: Array, rates: Array, terms: JointTerms, pressed: Array | None) -> Array:
        """Return the holding torque, shape (m,), N m.

        Args:
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            terms: The model at this posture.
            pressed: Torque with which the contacts pressed in the last tick, shape (m,), N m; None
                while a command takes over, whose drive is no load.
        """
        if pressed is not None:
            self._squeeze_with_load(terms.tips, pressed)
        posture, speed, acceleration = self._reference()
        w = self._bandwidth
        wanted = acceleration + 2.0 * w * (speed - rates) + w * w * (posture - theta)
        squeeze = self._pressed + (self._factor - 1.0) * self._squeeze
        self._ticks += 1
        return np.asarray(squeeze + terms.bias + terms.inertia @ wanted)

    def _squeeze_with_load(self, tips: Fingertips, pressed: Array) -> None:
        """Raise the squeeze by what the load has grown; it never falls while holding."""
        share = 1.0 - math.exp(-self._tick / FELT_TIME)
        self._felt = self._felt + share * (pressed - self._felt)
        if self._squeezing > LEAST_SQUEEZE:
            load, _ = split_forces(tip_forces(tips, self._felt))
            grown = float(np.linalg.norm(load - self._load))
            factor = 1.0 + grown / (self._config.friction * self._squeezing)
            self._factor = min(max(self._factor, factor), self._most)

    def _reference(self) -> tuple[Array, Array, Array]:
        """Return posture, rates and accelerations on the way to rest, which begin without a jerk.

        With x = t / T: q' = theta'_0 (1 + x) e^-x, which ends 2 T theta'_0 from the start.
        """
        stopping = self._config.stopping_time
        x = self._ticks * self._tick / stopping
        fading = math.exp(-x)
        posture = self._start + stopping * (2.0 - (2.0 + x) * fading) * self._speed
        speed = (1.0 + x) * fading * self._speed
        return posture, speed, -(x * fading / stopping) * self._speed


def tip_forces(tips: Fingertips, torque: Array) -> Array:
    """Return the forces at the tip centres that a joint torque balances, shape (k, 3), N.

    The least-squares solution of J_i^T f_i = tau, exact for fingers of three joints.
    """
    rows = tips.linear.reshape(-1, tips.linear.shape[-1])
    forces = np.linalg.lstsq(rows.T, torque, rcond=1e-6)[0]
    return np.asarray(forces.reshape(-1, 3))


def joint_torque(tips: Fingertips, forces: Array) -> Array:
    """Return the joint torques of forces at the tip centres, shape (m,), N m."""
    return np.asarray(np.einsum("kim,ki->m", tips.linear, forces))


def split_forces(forces: Array) -> tuple[Array, Array]:
    """Return the load that tip forces carry, shape (3,), N, and the forces without it, (k, 3).

    The load is their sum, which all tips share alike. Torques on the object cannot be separated
    from the squeeze: that needs the contacts, and here only the tips are known.
    """
    load = forces.sum(axis=0)
    return load, forces - load / len(forces)
