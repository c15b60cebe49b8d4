# SPDX-License-Identifier: Apache-2.0
"""Holding the joints without a law: what the controller and the guard at the joints fall back to.

`PostureHold` is the controller's: it knows the torque of the internal force and the load from its
law. `GuardHold` runs where torque meets the joints, from joint states and a model of the hand
alone. The contacts press on the joints with J_h^T f_c, which equation (3) gives from what is known,
over the last n ticks of length T:

    tau_c = mean(tau) - M_h (theta'_n - theta'_0) / (n T) - (C_h theta' + N_h).

The guard's hold keeps that torque, and nothing else of the last command: no drive and no damping.
With the posture q(t) that brings the joints from theta_0, theta'_0 to rest it answers

    tau = tau_c + (s - 1) J^T f_int + C_h theta' + N_h
          + M_h (q'' + 2 w (q' - theta') + w^2 (q - theta)).

f_int is the internal part of the tip forces; s grows with the load on the tips. See
docs/safe_hold.md for the derivation and measurements.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.hand.hand import Fingertips, Hand

Array = NDArray[np.float64]


_MAX_OFFSET, _MAX_RATE = np.pi, 1e3  # rad and rad/s; whatever is read, the torque stays finite


class PostureHoldConfig(Config):
    """Stiffness of the safe hold."""

    bandwidth: float = param(
        40.0, "stiffness w of the hold: joints return like w^2 M_h", unit="rad/s", gt=0.0, le=1e3
    )


class PostureHold:
    """Holds the joints where they are, on top of the torque of the internal force.

    tau = tau_internal + M_h (w^2 (theta_hold - theta) - 2 w theta'). The internal force never
    fades, which would drop the object, nor does it grow here, which would crush it: only the
    regulator raises it.

    The spring bears more than a wrong grasp force: two fingers that press against each other with a
    constant torque buckle, as if there were a negative stiffness of force times lever, 11 N m/rad
    with 1 kg in the hand. Shaped by the inertia it may be as stiff as late torques allow: 40 rad/s
    stay damped at 250 Hz with torques that act three ticks late. A guard at the joints, without
    delay, holds stiffer; see `GuardHold`.
    """

    def __init__(self, config: PostureHoldConfig) -> None:
        """Start released."""
        self._config = config
        self._posture: Array | None = None
        self._internal = np.zeros(0)

    @property
    def active(self) -> bool:
        """Whether the joints are held."""
        return self._posture is not None

    def engage(self, theta: Array, internal: Array) -> None:
        """Hold from now on; has no effect while already holding.

        Args:
            theta: Posture to hold, shape (m,), rad.
            internal: Torque to keep, shape (m,), N m.
        """
        if self._posture is None:
            self._posture, self._internal = theta.copy(), internal.copy()

    def move(self, theta: Array, internal: Array) -> None:
        """Hold another posture with another torque from now on, both of shape (m,)."""
        self._posture, self._internal = theta, internal

    def release(self) -> None:
        """Let go of the posture."""
        self._posture = None

    def torque(self, theta: Array, rates: Array, inertia: Array) -> Array:
        """Return the holding torque, shape (m,), N m; `engage` must have been called.

        Args:
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            inertia: M_h, shape (m, m), kg m^2.
        """
        assert self._posture is not None
        w = self._config.bandwidth
        away = np.clip(self._posture - theta, -_MAX_OFFSET, _MAX_OFFSET)
        rates = np.clip(rates, -_MAX_RATE, _MAX_RATE)
        return np.asarray(self._internal + inertia @ (w * w * away - 2.0 * w * rates))


@compiled
def bearable_fraction(internal: Array, rest: Array, limits: Array) -> float:
    """Return the largest s for which |s internal + rest| stays within the effort limits.

    A joint at its limit gives less than it is asked for, so that the internal force no longer
    balances and pushes the object away. The same fraction in all joints keeps the balance.

    Args:
        internal: Torque of the internal force, shape (m,), N m.
        rest: All other torque, shape (m,), N m.
        limits: Effort limits of the joints, shape (m,), N m.

    Returns:
        From 0 to 1; 1 where the limits allow the whole torque.
    """
    fraction = 1.0
    for i in range(len(limits)):
        if abs(internal[i] + rest[i]) > limits[i] and internal[i] != 0.0:
            room = limits[i] - np.sign(internal[i]) * rest[i]
            fraction = min(fraction, room / abs(internal[i]))
    return max(fraction, 0.0)


FELT_TIME = 0.005
"""Time over which the torque of the contacts is averaged [s]."""

MIN_INTERNAL_FORCE = 0.05
"""Fingers that press less in all hold nothing [N]."""

_MAX_PRODUCT = (
    0.25  # largest w T: the hold stays damped with a tick of delay, see docs/safe_hold.md
)


class GuardHoldConfig(Config):
    """How joints are held while there is no command for them."""

    bandwidth: float = param(
        100.0, "stiffness w: the joints return like w^2 M_h", unit="rad/s", gt=0.0, le=1e4
    )
    stopping_time: float = param(
        0.006, "time constant with which moving joints come to rest", unit="s", gt=0.0, le=1.0
    )
    reserve: float = param(
        0.2, "fraction by which the grasp force is raised immediately", ge=0.0, le=2.0
    )
    friction: float = param(
        0.2, "friction that load is assumed to have which comes during the hold", gt=0.0, le=10.0
    )
    squeeze_limit: float = param(
        40.0, "sum of internal forces above which the hold adds none", unit="N", ge=0.0, le=1e4
    )


class JointTerms(NamedTuple):
    """What the hand's model says of a posture.

    Attributes:
        tips: Fingertip centers and Jacobians.
        inertia: M_h, shape (m, m).
        bias: C_h theta' + N_h, shape (m,), N m.
    """

    tips: Fingertips
    inertia: Array
    bias: Array


class GuardHold:
    """Holds the joints from joint states alone; `engage` at the first tick, `step` at each."""

    def __init__(self, config: GuardHoldConfig, hand: Hand, tick: float) -> None:
        """Take the model.

        Args:
            config: Stiffness, braking and internal force.
            hand: Model of the hand, with gravity.
            tick: Time between two calls of `step`, s.
        """
        self._config, self._hand, self._tick = config, hand, tick
        self._bandwidth = min(config.bandwidth, _MAX_PRODUCT / tick)

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
        self._internal_force = float(np.linalg.norm(internal, axis=1).sum())
        self._internal = joint_torque(tips, internal)
        self._most = self._largest_factor()
        self._factor = min(1.0 + self._config.reserve, self._most)
        self.brake(theta, rates)

    def _largest_factor(self) -> float:
        """Return s at the limit of the internal force or of a joint, at least 1."""
        if self._internal_force < MIN_INTERNAL_FORCE:
            return 1.0
        room = self._hand.effort_limits - np.abs(self._pressed)
        moved = np.abs(self._internal)
        joints = room[moved > 0.0] / moved[moved > 0.0]
        factors = [
            self._config.squeeze_limit / self._internal_force,
            1.0 + float(np.min(joints, initial=np.inf)),
        ]
        return max(1.0, min(factors))

    def brake(self, theta: Array, rates: Array) -> None:
        """Come to rest from this posture and these rates, with the internal force as it is."""
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
            self._follow_load(terms.tips, pressed)
        posture, speed, acceleration = self._reference()
        w = self._bandwidth
        wanted = acceleration + 2.0 * w * (speed - rates) + w * w * (posture - theta)
        internal = self._pressed + (self._factor - 1.0) * self._internal
        self._ticks += 1
        return np.asarray(internal + terms.bias + terms.inertia @ wanted)

    def _follow_load(self, tips: Fingertips, pressed: Array) -> None:
        """Raise the internal force by what the load has grown; it never falls while holding."""
        fraction = 1.0 - math.exp(-self._tick / FELT_TIME)
        self._felt = self._felt + fraction * (pressed - self._felt)
        if self._internal_force > MIN_INTERNAL_FORCE:
            load, _ = split_forces(tip_forces(tips, self._felt))
            grown = float(np.linalg.norm(load - self._load))
            factor = 1.0 + grown / (self._config.friction * self._internal_force)
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
    """Return the forces at the tip centers that a joint torque balances, shape (k, 3), N.

    The least-squares solution of J_i^T f_i = tau, exact for fingers of three joints.
    """
    rows = tips.linear.reshape(-1, tips.linear.shape[-1])
    forces = np.linalg.lstsq(rows.T, torque, rcond=1e-6)[0]
    return np.asarray(forces.reshape(-1, 3))


def joint_torque(tips: Fingertips, forces: Array) -> Array:
    """Return the joint torques of forces at the tip centers, shape (m,), N m."""
    return np.asarray(np.einsum("kim,ki->m", tips.linear, forces))


def split_forces(forces: Array) -> tuple[Array, Array]:
    """Return the load that tip forces carry, shape (3,), N, and the forces without it, (k, 3).

    The load is their sum, which all tips share alike. Torques on the object cannot be separated
    from the internal force: that needs the contacts, and here only the tips are known.
    """
    load = forces.sum(axis=0)
    return load, forces - load / len(forces)
