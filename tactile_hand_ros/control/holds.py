# SPDX-License-Identifier: Apache-2.0
"""Holding the joints without a law: the fallback of the controller and of the guard at the joints.

Both keep the torque of the contacts and add a spring and a damper in proportion to the inertia,
M_h (w^2 e + 2 w e'), with e = posture to hold - theta. See docs/explanation/safe-hold.md.

Under constant forces a grasp buckles: along motions N of joints and object that keep the contacts
(rolling, A1), its geometric stiffness K_geo = d(J_h^T f) - d(G f) may be negative, and a deviation
grows with e^(p t), p^2 = max(-N^T K_geo N / N^T M_h N). So the internal forces turn with the
fingers, see `GraspTorque`. See `required_bandwidth` for how late they may do so.

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
from tactile_hand_ros.control.contact import Contacts, hand_jacobian, joint_torques
from tactile_hand_ros.control.grasp import centered, grasp_map
from tactile_hand_ros.control.laws import FittedGains
from tactile_hand_ros.hand.hand import Dynamics, Fingertips, Hand, least_squares, tip_forces
from tactile_hand_ros.rotations import dot

_PHASE = 0.5  # w d: leaves 17 degrees of phase at the longest delay, 47 at half of it
_DAMPING_PHASE = 1.25  # w d of damping alone: leaves 18 degrees
_POSE_PHASE = 0.25  # of the stiffness, by age of touch and object; fraction of damping lost to age
_SHAKE = 0.03  # of a finger's weight, by angle errors; the grasp force has 0.6 in reserve
_MARGIN = 1.5  # of the damping over what late forces cost
_MAX_OFFSET, _MAX_RATE = np.pi, 1e3  # rad and rad/s; keep the torque finite
_OBSERVES = 3.0  # w times T of the load observer; one twice as fast feeds back encoder noise
_MASS = 1.5 / 9.81  # kg per N of load; objects reach beyond their contacts
_STEP = 1e-5  # of finite differences, rad
_INDEPENDENT = 1e-9  # of the largest singular value; smaller ones are rounding


def stiffest(hand: Hand, inertia: Array, tick: float, late: float, error: float) -> float:
    """Return the largest bandwidth w of a hold with an inertia M_h, shape (m, m), rad/s.

    Rates estimated from angles are late by half a `tick`, torques by at most `late`, s. `error` is
    the largest error of an angle, rad; 0 for exact angles and rates.
    """
    if error == 0.0:
        return _PHASE / late
    quietest = float(_quietest(hand, inertia.diagonal().max(), error))
    return min(_PHASE / (late + 0.5 * tick), quietest)


def _quietest(hand: Hand, inertia: Array, error: float) -> Array:
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


def required_bandwidth(buckling: float, late: float) -> float:
    """Return the smallest w, rad/s, of a hold for a grasp that buckles at p, 1/s, with a margin.

    Forces that turn with the fingers d = `late` s late cost the damping p^2 d of 2 w.
    """
    return 0.5 * _MARGIN * buckling**2 * late


def buckling_rate(
    hand: Hand, theta: Array, contacts: Contacts, forces: Array, motions: Array | None = None
) -> float:
    """Return the p, 1/s, with which a grasp under constant forces buckles, e^(p t).

    It grows with the square root of the internal forces, (k, 3), N, palm axes. All fingers touch.
    `motions`, joint rates above twists, shape (m + 6, n), are those in which it may buckle; by
    default all that keep the contacts.
    """
    m, tips = hand.joints, hand.fingertips(theta)
    motions = _motions(hand, tips, contacts) if motions is None else motions
    arms = contacts.positions - tips.positions
    stiffness = np.empty((motions.shape[1],) * 2)
    for i, motion in enumerate(motions.T):
        rates, velocity, spin = motion[:m], motion[m : m + 3], motion[m + 3 :]
        ahead, behind = (hand.fingertips(theta + sign * _STEP * rates) for sign in (1.0, -1.0))
        rolling = np.cross(spin, arms)
        missing = np.empty(m + 6)
        pressing = (joint_torques(each, each.positions + arms, forces) for each in (ahead, behind))
        missing[:m] = np.subtract(*pressing) / (2.0 * _STEP)
        missing[:m] += np.einsum("kim,ki->m", tips.angular, np.cross(rolling, forces))
        moved = tips.linear @ rates + rolling - velocity
        missing[m : m + 3], missing[m + 3 :] = 0.0, -np.cross(moved, forces).sum(axis=0)
        stiffness[:, i] = motions.T @ missing
    joints = motions[:m]
    inertia = joints.T @ hand.dynamics(theta, np.zeros(m)).inertia @ joints
    softest = _ratios(0.5 * (stiffness + stiffness.T), inertia)[0].min(initial=np.inf)
    return math.sqrt(max(0.0, -softest))


def fitted_gains(
    hand: Hand,
    theta: Array,
    contacts: Contacts,
    forces: Array,
    tick: float,
    touch: float,
    follows: float,
    error: float = 0.0,
    delay: int = 0,
) -> FittedGains:
    """Return gains that fit a hand: the damping K_c = w M_h, or D at the grasp, and K_p.

    Angle errors bound w along each principal axis of M_h; light joints, which alone turn some
    objects, bear more than heavy ones. Torques that are held for T make fingers oscillate at
    w = 2 / T. An object adds inertia, so w is at most 1 / T. Torques that are n ticks late cost the
    phase w (n + 1/2) T of the damping, at most 72 of its 90 degrees. Directions of forces f that
    are d old cost the damping K_geo d, a fraction of it at w = b^2 d over that fraction, with the
    rate b of `buckling_rate` at that k_f and the margin. This is w, unless angle errors allow more.
    Rates that do not move the object are damped as much as angle errors allow.

    The pose is t late, and the object, of inertia m, follows the damping after m / D. Both cost
    phase of the stiffness, so K_p = p D / (t + m / D), with the m of an object whose weight is the
    load of `FittedGains.at`, as far from its center as the contacts.

    Args:
        hand: The hand.
        theta: Joint angles, shape (m,), rad.
        contacts: Contacts with the object; all fingers must touch.
        forces: Internal forces of a k_f of 1 N in palm axes, shape (k, 3), N.
        tick: T, s.
        touch: d, age of touch, s.
        follows: Time constant of the load observer, s; t - d unless coarse encoders need more.
        error: Largest error of an angle, rad.
        delay: n, the largest delay of a torque, ticks.
    """
    inertia = hand.dynamics(theta, np.zeros(hand.joints)).inertia
    largest = min(1.0, _DAMPING_PHASE / (delay + 0.5)) / tick
    inertias, axes = np.linalg.eigh(inertia)
    bounds = np.minimum(_quietest(hand, inertias, error), largest)
    quiet = (axes * inertias * bounds) @ axes.T
    motions = _motions(hand, hand.fingertips(theta), contacts)
    joints, twists = np.split(motions, [hand.joints])
    redundant = joints @ _kernel(twists)
    motions = motions @ _kernel(redundant.T @ inertia @ joints)
    joints = motions[: hand.joints]
    quietest, parts = _ratios(joints.T @ quiet @ joints, joints.T @ inertia @ joints)
    momenta = inertia @ joints @ parts
    still = np.eye(hand.joints) - joints @ parts @ momenta.T
    buckling = buckling_rate(hand, theta, contacts, forces, motions)
    needed = _MARGIN * buckling**2 * touch / _POSE_PHASE
    wrenches = _rates_of_twists(motions).T @ momenta
    rest = still.T @ quiet @ still
    observes = _OBSERVES / quietest.min(initial=largest)
    lag = (touch + max(follows, observes)) / _POSE_PHASE
    square = (centered(contacts.positions) ** 2).sum() / hand.fingers
    body = np.repeat([1.0, square], 3) * _MASS / _POSE_PHASE
    return FittedGains(rest, momenta, wrenches, quietest, needed, largest, lag, body, observes)


def largest_damping(
    hand: Hand, theta: Array, contacts: Contacts, body: Array, tick: float
) -> float:
    """Return the joint damping K_c, N m s/rad, above which a grasp at theta oscillates.

    A torque -K_c theta' that is held for a tick of T s reverses the rates if K_c T / M_h > 2, in
    motions that keep the contacts. All fingers touch. `body` is the inertia of the object, linear
    above angular, palm axes, shape (6, 6).
    """
    joints, twists = np.split(_motions(hand, hand.fingertips(theta), contacts), [hand.joints])
    inertia = joints.T @ hand.dynamics(theta, np.zeros(hand.joints)).inertia @ joints
    inertia += twists.T @ body @ twists
    return float(2.0 * _ratios(inertia, joints.T @ joints)[0].min(initial=np.inf) / tick)


def largest_stiffness(
    hand: Hand, theta: Array, contacts: Contacts, damping: float, late: float
) -> tuple[float, float]:
    """Return k_p, N/m, and k_o, N m/rad, above which the delay of their torque cancels the damping.

    A force -k x that is d s late lowers the damping by k d: k d < D, with the minimum damping D of
    the grasp at theta in any direction, from K_c in N m s/rad. All fingers touch.
    """
    rates = _rates_of_twists(_motions(hand, hand.fingertips(theta), contacts))
    linear, angular = (np.linalg.svd(part, compute_uv=False)[-1] for part in np.split(rates, 2, 1))
    return damping * linear**2 / late, 0.5 * damping * angular**2 / late


def motions_of_object(hand: Hand, theta: Array, contacts: Contacts) -> int:
    """Return in how many directions of 6 the joints, at theta, move the object.

    All contacts hold, and all fingers touch.
    """
    twists = _motions(hand, hand.fingertips(theta), contacts)[-6:]
    return int(np.linalg.matrix_rank(twists, tol=_INDEPENDENT)) if twists.size else 0


def kept_contacts(hand: Hand, theta: Array, contacts: Contacts) -> Array:
    """Return the projection, (m, m), of joint rates on those that keep contacts of all fingers."""
    rates = _motions(hand, hand.fingertips(theta), contacts)[: hand.joints]
    return np.asarray(rates @ np.linalg.pinv(rates, rcond=_INDEPENDENT))


def _rates_of_twists(motions: Array) -> Array:
    """Return the joint rates of unit twists in motions of joints and object, shape (m, 6)."""
    return np.asarray(motions[:-6] @ np.linalg.pinv(motions[-6:], rcond=_INDEPENDENT))


def _motions(hand: Hand, tips: Fingertips, contacts: Contacts) -> Array:
    """Return joint rates above twists of the object that keep the contacts, shape (m + 6, n).

    Motions of the object alone, as about the line of two contacts, are left out.
    """
    k, axes = hand.fingers, np.tile(np.eye(3), (hand.fingers, 1, 1))
    jacobian = hand_jacobian(tips, contacts.positions, axes).reshape(3 * k, hand.joints)
    motions = _kernel(np.hstack([jacobian, -grasp_map(centered(contacts.positions), axes).T]))
    idle = _kernel(motions[: hand.joints])
    return motions @ _kernel(idle.T) if idle.size else motions


def _kernel(matrix: Array) -> Array:
    """Return an orthonormal basis of the kernel of a matrix, one vector per column."""
    _, sizes, basis = np.linalg.svd(matrix)
    rank = int((sizes > _INDEPENDENT * sizes.max(initial=0.0)).sum())
    return np.asarray(basis[rank:].T)


def _ratios(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the stationary values of x^T a x / x^T b x, rising, and their x with x^T b x = 1."""
    root = np.linalg.cholesky(b)
    values, vectors = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, a).T))
    return values, np.linalg.solve(root.T, vectors)


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

    def scaled(self, factor: float) -> GraspTorque:
        """Return it with all parts multiplied by a factor."""
        return GraspTorque(factor * self.tensions, factor * self.load)

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
            pull = tensions[pair] / max(math.sqrt(dot(along, along)), _INDEPENDENT) * along
            forces[i] += pull
            forces[j] -= pull
            pair += 1
    return forces


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
