# SPDX-License-Identifier: Apache-2.0
"""How stiff and damped a grasp must be and may be, from its geometry, its inertia and its delays.

Under constant forces a grasp buckles: along motions N of joints and object that keep the contacts
(rolling, A1), its geometric stiffness K_geo = d(J_h^T f) - d(G f) may be negative, and a deviation
grows with e^(p t), p^2 = max(-N^T K_geo N / N^T M_h N). See `buckling_rate`.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts, hand_jacobian, joint_torques
from tactile_hand_ros.control.grasp import centered, grasp_map
from tactile_hand_ros.control.holds import quiet_bandwidths
from tactile_hand_ros.control.laws import FittedGains
from tactile_hand_ros.hand.hand import Fingertips, Hand

_DAMPING_PHASE = 1.25  # w d of damping alone: leaves 18 degrees
_POSE_PHASE = 0.25  # of the stiffness, by age of touch and object; fraction of damping lost to age
_MARGIN = 1.5  # of the damping over what late forces cost
_OBSERVES = 3.0  # w times T of the load observer; one twice as fast feeds back encoder noise
_MASS = 1.5 / 9.81  # kg per N of load; objects reach beyond their contacts
_STEP = 1e-5  # of finite differences, rad
_INDEPENDENT = 1e-9  # of the largest singular value; smaller ones are rounding


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
    phase w (n + 1/2) T of the damping, and rates from angles w T / 2 more, at most 72 of its 90
    degrees. Directions of forces f that are d old cost the damping K_geo d, a fraction of it at
    w = b^2 d over that fraction, with the rate b of `buckling_rate` at that k_f and the margin.
    This is w, unless angle errors allow more. Rates that do not move the object are damped as much
    as angle errors allow.

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
    late = delay + (0.5 if error == 0.0 else 1.0)
    largest = min(1.0, _DAMPING_PHASE / late) / tick
    inertias, axes = np.linalg.eigh(inertia)
    bounds = np.minimum(quiet_bandwidths(hand, inertias, error), largest)
    quiet = (axes * inertias * bounds) @ axes.T
    motions = _motions(hand, hand.fingertips(theta), contacts)
    joints, twists = np.split(motions, [hand.joints])
    redundant = joints @ _kernel(twists, 1.0)
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
    idle = _kernel(motions[: hand.joints], 1.0)
    return motions @ _kernel(idle.T) if idle.size else motions


def _kernel(matrix: Array, size: float = 0.0) -> Array:
    """Return an orthonormal basis of the kernel of a matrix, one vector per column.

    Parts of unit vectors have the `size` 1, so that one of rounding errors alone counts as zero.
    """
    _, sizes, basis = np.linalg.svd(matrix)
    rank = int((sizes > _INDEPENDENT * sizes.max(initial=size)).sum())
    return np.asarray(basis[rank:].T)


def _ratios(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the stationary values of x^T a x / x^T b x, rising, and their x with x^T b x = 1."""
    root = np.linalg.cholesky(b)
    values, vectors = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, a).T))
    return values, np.linalg.solve(root.T, vectors)
