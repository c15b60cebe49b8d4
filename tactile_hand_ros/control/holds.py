# SPDX-License-Identifier: Apache-2.0
"""Holding the joints without a law: the fallback of the controller and of the guard at the joints.

Both keep the torque of the contacts and add a spring and a damper in proportion to the inertia,
M_h (w^2 e + 2 w e'), with e = posture to hold - theta. See docs/explanation/safe-hold.md.

Under constant forces a grasp buckles, so the internal forces turn with the fingers, see
`GraspTorque`. See `stability.required_bandwidth` for how late they may do so.

The delay d of the spring limits w: its loop (w^2 + 2 w s) / s^2 crosses over at 2.06 w with a phase
margin of 1.33 rad, which the delay lowers by 2.06 w d. See `stiffest`.

`GuardHold` uses joint states and a model of the hand alone. Its torque is

    tau = tau_l + s J^T f_int + C_h theta' + N_h
          + M_h (q'' + 2 w (q' - theta') + w^2 (q - theta)),

with internal forces f_int along the lines between the tips, which turn with them, the torque tau_l
of all other forces at the start, a factor s that grows with the load on the tips, and a posture
q(t) that comes to rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import all_finite, joint_torques
from tactile_hand_ros.control.laws import bearable_fraction
from tactile_hand_ros.hand.hand import Dynamics, Fingertips, Hand, least_squares, tip_forces
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import dot

_PHASE = 0.5  # w d: leaves 17 degrees of phase at the longest delay, 47 at half of it
_SHAKE = 0.03  # of a finger's weight, by angle errors; the grasp force has 0.6 in reserve
_MAX_OFFSET, _MAX_RATE = np.pi, 1e3  # rad and rad/s; keep the torque finite
_FIRST_PERIOD = 0.01  # s between ticks, assumed before the second tick
_SHORTEST = 1e-9  # m, keeps the direction between two tips regular


def stiffest(hand: Hand, inertia: Array, tick: float, late: float, error: float) -> float:
    """Return the largest bandwidth w of a hold with an inertia M_h, shape (m, m), rad/s.

    Rates estimated from angles are late by half a `tick`, torques by at most `late`, s. `error` is
    the largest error of an angle, rad; 0 for exact angles and rates.
    """
    if error == 0.0:
        return _PHASE / late
    quiet = float(quiet_bandwidths(hand, inertia.diagonal().max(), error))
    return min(_PHASE / (late + 0.5 * tick), quiet)


def quiet_bandwidths(hand: Hand, inertia: Array, error: float) -> Array:
    """Return bandwidths w, rad/s, at which angle errors e shake the hand as much as allowed.

    Their torque I w^2 e, with inertias I of any shape, kg m^2, may be a fraction of that of a
    finger's weight at its full reach.
    """
    allowed = _SHAKE * hand.finger_weight * hand.spans.max()
    return np.sqrt(allowed / (inertia * error)) if error > 0.0 else np.full_like(inertia, math.inf)


def spring(inertia: Array, w: float, away: Array, rates: Array) -> Array:
    """Return M_h (w^2 away + 2 w rates), shape (m,), N m, finite for any finite input.

    `away` and `rates` are the posture to hold less that of the joints, rad, and its rates, rad/s.
    """
    away = np.clip(away, -_MAX_OFFSET, _MAX_OFFSET)
    rates = np.clip(rates, -_MAX_RATE, _MAX_RATE)
    return np.asarray(inertia @ (w * w * away + 2.0 * w * rates))


class GuardHoldConfig(Config):
    """Parameters of the hold without a command."""

    resolution: float = param(
        0.0, "error of a measured joint angle, 0 if exact", unit="rad", ge=0.0, le=0.1
    )
    stopping_time: float = param(
        0.006, "time constant with which moving joints come to rest", unit="s", gt=0.0, le=1.0
    )
    reserve: float = param(0.2, "immediate rise of the grasp force, as a fraction", ge=0.0, le=2.0)
    friction: float = param(
        0.2, "friction coefficient assumed for loads that appear during a hold", gt=0.0, le=10.0
    )
    internal_force_limit: float = param(
        40.0, "sum of internal forces above which the hold adds none", unit="N", ge=0.0, le=1e4
    )


_LOAD_TIME = 0.005  # s over which the load is averaged


class GraspTorque(NamedTuple):
    """Joint torques that press with tensions between the fingertips, and carry a load.

    The tensions follow the fingers. Forces of constant direction would turn an object further that
    has turned, so that light fingers buckle.

    Attributes:
        tensions: Tensions between each two fingertips, N.
        load: Torque of the other forces, shape (m,), N m.
    """

    tensions: Array
    load: Array

    @classmethod
    def of(cls, tips: Fingertips, torque: Array) -> GraspTorque:
        """Return a torque of the contacts, shape (m,), N m, in these parts."""
        return cls(*_split(tips, torque))

    def internal_forces(self, tips: Fingertips) -> Array:
        """Return the internal forces at these fingertips, shape (k, 3), N, palm axes."""
        return _pulls(tips.positions, self.tensions)

    def at(self, tips: Fingertips, factor: float) -> Array:
        """Return the torque at these fingertips, (m,), N m, with a factor of the tensions."""
        return np.asarray(self.load + factor * joint_torque(tips, self.internal_forces(tips)))


@compiled
def _split(tips: Fingertips, torque: Array) -> tuple[Array, Array]:
    """Return tensions and load of a torque; see `GraspTorque`."""
    k = len(tips.positions)
    along = np.empty((3 * k, k * (k - 1) // 2))
    for pair, unit in enumerate(np.eye(along.shape[1])):
        along[:, pair] = _pulls(tips.positions, unit).ravel()
    tensions = least_squares(along, tip_forces(tips, torque).ravel())
    return tensions, torque - joint_torque(tips, _pulls(tips.positions, tensions))


@compiled
def _pulls(positions: Array, tensions: Array) -> Array:
    """Return the forces, (k, 3), N, of tensions between each two points, (k, 3), m."""
    forces, pair = np.zeros(positions.shape), 0
    for i in range(len(positions)):
        for j in range(i + 1, len(positions)):
            along = positions[j] - positions[i]
            pull = tensions[pair] / max(math.sqrt(dot(along, along)), _SHORTEST) * along
            forces[i] += pull
            forces[j] -= pull
            pair += 1
    return forces


class PostureHoldConfig(Config):
    """Delay and resolution of the joints; with the tick period they limit stiffness and damping."""

    latency: int = param(3, "largest delay of a torque", unit="ticks", live=True, ge=0, le=100)
    resolution: float = param(
        0.0, "error of a measured joint angle, 0 if exact", unit="rad", live=True, ge=0.0, le=0.1
    )


class Held(NamedTuple):
    """Torques of the last good tick, which a hold keeps: internal force and load, (m,), N m.

    `grasp_force` is the k_f of that internal force, N; 0 if unknown.
    """

    internal: GraspTorque
    load: Array
    grasp_force: float = 0.0


class PostureHold:
    """Keeps posture and grasp force while the law of the controller cannot act.

    The spring is as stiff as the tick period allows.

    Attributes:
        config: Its parameters, which may change at any time.
        period: Time between ticks, s.
        posture: Joint angles to keep, shape (m,), rad.
        held: Torques to keep; None while unknown.
    """

    def __init__(self, config: PostureHoldConfig, hand: Hand) -> None:
        """Build the hold of a hand."""
        self.config, self._hand = config, hand
        self.reset()

    def reset(self) -> None:
        """Forget what is held, and the time between ticks."""
        self.period, self.posture = _FIRST_PERIOD, np.zeros(self._hand.joints)
        self.held: Held | None = None

    @property
    def delay(self) -> float:
        """How late its torques act, s; half a tick, as they last for one, and more."""
        return (0.5 + self.config.latency) * self.period

    def bandwidth(self, inertia: Array) -> float:
        """Return its bandwidth, rad/s, with an inertia M_h, shape (m, m)."""
        return stiffest(self._hand, inertia, self.period, self.delay, self.config.resolution)

    def spring(self, theta: Array, rates: Array) -> Array:
        """Return the torque that brings the joints back to the posture, (m,), N m."""
        inertia = self._hand.dynamics(theta, rates).inertia
        return spring(inertia, self.bandwidth(inertia), self.posture - theta, -rates)

    def engage(self, theta: Array) -> None:
        """Let the internal force turn with the fingers from angles on, shape (m,), rad."""
        if self.held is not None:
            internal = GraspTorque.of(self._hand.fingertips(theta), self.held.internal.load)
            self.held = self.held._replace(internal=internal)

    def release(self) -> None:
        """Keep no grasp force from now on."""
        none = np.zeros(self._hand.joints)
        self.held = Held(GraspTorque(none[:0], none), none)

    def step(self, joints: Joints, weight: Array, grasp_force: float) -> Array:
        """Return the holding torque, shape (m,), N m.

        Before its first grasp a hold keeps the torque that acts on the joints. Another controller
        may have crashed with the object in the hand.

        Args:
            joints: Report of the joints.
            weight: Torque that carries the links, shape (m,), N m.
            grasp_force: k_f, N, with which the held force rises, and never falls; 0 if unknown.
        """
        tips = self._hand.fingertips(joints.theta)
        held = self._kept(tips, weight, joints.applied, grasp_force)
        rest = held.load + self.spring(joints.theta, joints.rates) + weight
        internal, limits = held.internal.at(tips, 1.0), self._hand.effort_limits
        # A spring at its limit, at a finger that is pushed away, must not take the others' grasp.
        fraction = bearable_fraction(internal, held.load + weight, limits)
        return np.asarray(np.clip(fraction * internal + rest, -limits, limits))

    def _kept(
        self, tips: Fingertips, weight: Array, applied: Array | None, grasp_force: float
    ) -> Held:
        """Return the torques to keep: those since the last tick, or raised for a larger k_f, N."""
        none = np.zeros(self._hand.joints)
        if self.held is None:
            if applied is None or not applied.any() or not all_finite(applied):
                return Held(GraspTorque.of(tips, none), none)  # still unknown
            self.held = Held(GraspTorque.of(tips, applied - weight), none)
        internal, load, before = self.held
        if 0.0 < before < grasp_force:
            more = GraspTorque(*(grasp_force / before * part for part in internal))
            self.held = Held(more, load, grasp_force)
        return self.held


class GuardHold:
    """Holds the joints from joint states alone: call `engage` first, then `step` at each tick.

    Attributes:
        reference: Posture and rates on the way to rest, each of shape (m,), rad and rad/s.
        bandwidth: Stiffness w of this hold, rad/s.
    """

    def __init__(self, config: GuardHoldConfig, hand: Hand, tick: float) -> None:
        """Build the hold of a hand with gravity; `tick` is the time between two steps, s."""
        self._config, self._hand, self._tick = config, hand, tick

    def engage(self, theta: Array, rates: Array, pressed: Array) -> None:
        """Start a hold at angles, rad, and rates, rad/s, with tau_c, N m, all of shape (m,)."""
        self._deflected = np.zeros(len(pressed))
        tips, inertia, _ = self._hand.dynamics(theta, rates)
        # A torque that is held for a tick is half a tick late; the other half is for the drive.
        how = self._tick, self._tick, self._config.resolution
        self.bandwidth = stiffest(self._hand, inertia, *how)
        self._grasp = GraspTorque.of(tips, pressed)
        internal = self._grasp.internal_forces(tips)
        self._internal_force = float(np.linalg.norm(internal, axis=1).sum())
        room = self._hand.effort_limits - np.abs(pressed)
        self._largest = self._largest_factor(room, np.abs(joint_torque(tips, internal)))
        self._factor = min(1.0 + self._config.reserve, self._largest)
        self.brake(theta, rates)

    def _largest_factor(self, room: Array, moved: Array) -> float:
        """Return s at the limit of the internal force or of a joint, at least 1.

        The joints have room for torques of shape (m,), N m, and the internal force needs `moved`.
        """
        if self._internal_force < self._hand.minimum_force:
            return 1.0
        joints = room[moved > 0.0] / moved[moved > 0.0]
        limit = self._config.internal_force_limit / self._internal_force
        return max(1.0, min(limit, 1.0 + float(np.min(joints, initial=np.inf))))

    def brake(self, theta: Array, rates: Array) -> None:
        """Come to rest from angles, rad, and rates, rad/s; internal force and load stay."""
        # Without the deflection that carries it, the load would move the joints at each new start.
        self._start, self._speed, self._ticks = theta + self._deflected, rates.copy(), 0

    def step(self, joints: tuple[Array, Array] | None, terms: Dynamics, *, follows: bool) -> Array:
        """Return the holding torque, shape (m,), N m.

        `joints` are angles, rad, and rates, rad/s; None if unknown, as if they followed the
        reference under the last load. `terms` is the model at this posture. The internal force
        follows the load, except while a command takes over, whose drive is not a load.
        """
        acceleration = self._move_reference()
        posture, speed = self.reference
        theta, rates = joints or (posture - self._deflected, speed)
        away, w = posture - theta, self.bandwidth
        if follows:
            self._follow_load(terms, away)
        held = self._grasp.at(terms.tips, self._factor) + terms.bias + terms.inertia @ acceleration
        return np.asarray(held + spring(terms.inertia, w, away, speed - rates))

    def _follow_load(self, terms: Dynamics, away: Array) -> None:
        """Raise the internal force with the load; it never falls during a hold.

        The load is the deflection of the spring, from angles alone and beyond their resolution, so
        that noise of the rates does not count.
        """
        fraction = -math.expm1(-self._tick / _LOAD_TIME)
        self._deflected = self._deflected + fraction * (away - self._deflected)
        if self._internal_force < self._hand.minimum_force:
            return
        c, stiffness = self._config, self.bandwidth**2 * terms.inertia
        beyond = np.maximum(np.abs(self._deflected) - c.resolution, 0.0)
        deflection = np.sign(self._deflected) * beyond
        load = tip_forces(terms.tips, stiffness @ deflection).sum(axis=0)
        factor = 1.0 + float(np.linalg.norm(load)) / (c.friction * self._internal_force)
        self._factor = min(max(self._factor, factor), self._largest)

    def _move_reference(self) -> Array:
        """Move the reference towards rest; return its acceleration, shape (m,), rad/s^2.

        With x = t / T: q' = theta'_0 (1 + x) e^-x, which stops 2 T theta'_0 from the start.
        """
        stopping = self._config.stopping_time
        x = self._ticks * self._tick / stopping
        fading = math.exp(-x)
        posture = self._start + stopping * (2.0 - (2.0 + x) * fading) * self._speed
        self.reference = posture, (1.0 + x) * fading * self._speed
        self._ticks += 1
        return -(x * fading / stopping) * self._speed


@compiled
def joint_torque(tips: Fingertips, forces: Array) -> Array:
    """Return the joint torques, (m,), N m, of forces, (k, 3), N, at the tip centers."""
    return joint_torques(tips, tips.positions, forces)
