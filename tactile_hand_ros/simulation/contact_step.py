# SPDX-License-Identifier: Apache-2.0
"""One step of hand, object and the contacts between them, on arrays; see `plant`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.contact import contact_frame, hand_jacobian
from tactile_hand_ros.control.grasp import grasp_map
from tactile_hand_ros.hand.hand import Fingertips, tip_jacobians
from tactile_hand_ros.rotations import rodrigues
from tactile_hand_ros.simulation.coulomb import EXACT, solve_contacts
from tactile_hand_ros.simulation.solid import Shape, closest_point

Array = NDArray[np.float64]

TOUCH = 1e-6  # gap below which a finger counts as touching, m
NEAR = 2e-3  # gap below which a contact is part of the problem of a step, m
_RECOVERY = 0.2  # share of a penetration that is removed in a step
_FASTEST_RECOVERY = 5e-3  # and its highest speed, m/s: what leaves is not to fly off


class HandTerms(NamedTuple):
    """The hand: its posture at the start of a step, all else half a step ahead.

    Attributes:
        theta: Joint angles at the start, shape (m,), rad.
        tips: Fingertip centres, palm frame, shape (k, 3), m.
        spatial: Velocities of the bodies at the palm's origin per joint rate, shape (6, m).
        support: Which joints move which tip, shape (k, m).
        inertia: M_h, of which only the upper triangle counts, shape (m, m).
        bias: C_h theta' + N_h, shape (m,), N m.
        torque: tau, shape (m,), N m.
        radii: Fingertip radii, shape (k,), m.
    """

    theta: Array
    tips: Array
    spatial: Array
    support: NDArray[np.bool_]
    inertia: Array
    bias: Array
    torque: Array
    radii: Array


class Body(NamedTuple):
    """The object at the start of a step.

    Attributes:
        position: Centre of mass, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        spin: Angular velocity half a step ahead, shape (3,), rad/s.
        mass: Mass, kg.
        inertia: Inertia in the object frame, shape (3, 3), kg m^2.
        wrench: External wrench and weight about the centre of mass, shape (6,), N and N m.
    """

    position: Array
    rotation: Array
    spin: Array
    mass: float
    inertia: Array
    wrench: Array


class Past(NamedTuple):
    """What a step needs of the one before.

    Attributes:
        velocities: Joint rates, velocity and spin of the object at its start, shape (m + 6,).
        rows: A of `velocity_map` half a step after its start, shape (k, 3, m + 6).
        impulses: Impulses on the object in contact frames, shape (k, 3), N s.
        settled: Which contacts were closed and pushed already, so that nothing struck, shape (k,).
        slid: Distance that each contact has slid since the start, shape (k,), m.
    """

    velocities: Array
    rows: Array
    impulses: Array
    settled: NDArray[np.bool_]
    slid: Array


class StepResult(NamedTuple):
    """Outcome of a step.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        velocities: Joint rates, velocity and spin of the object after the step, shape (m + 6,).
        position: Centre of mass, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        sliding: Tangential velocities of the object against the tips (x, z), shape (k, 2), m/s.
        past: What the next step needs of this one.
        residual: Largest relative violation of the contact laws.
        outcome: EXACT, RELAXED or UNSOLVED of `coulomb`.
    """

    theta: Array
    velocities: Array
    position: Array
    rotation: Array
    sliding: Array
    past: Past
    residual: float
    outcome: int


def no_past(fingers: int, v: Array) -> Past:
    """Return the past of k fingers that start to move with velocities v, shape (m + 6,)."""
    k, n = fingers, len(v)
    settled = np.zeros(k, dtype=np.bool_)
    return Past(v, np.zeros((k, 3, n)), np.zeros((k, 3)), settled, np.zeros(k))


@compiled
def half_step(h: float, theta: Array, v: Array, before: Array) -> tuple[Array, Array]:
    """Return joint angles and velocities half a step of h, in s, ahead.

    Forces that grow with the square of the rates need the velocities there as well.

    Args:
        h: Length of the step, s.
        theta: Joint angles at its start, shape (m,), rad.
        v: Joint rates, velocity and spin of the object at its start, shape (m + 6,).
        before: The same one step earlier.
    """
    return theta + 0.5 * h * v[: len(theta)], v + 0.5 * (v - before)


@compiled
def contact_geometry(
    shape: Shape, position: Array, rotation: Array, tips: Array, radii: Array
) -> tuple[Array, Array, Array]:
    """Return where fingertips touch or come closest to the object.

    Args:
        shape: The object.
        position: Its centre of mass, palm frame, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        tips: Fingertip centres, palm frame, shape (k, 3), m.
        radii: Fingertip radii, shape (k,), m.

    Returns:
        Points on the fingertips p_c = p_f + r n, shape (k, 3), contact frames, shape (k, 3, 3), and
        gaps, shape (k,), m.
    """
    k = len(tips)
    points, frames, gaps = np.empty((k, 3)), np.empty((k, 3, 3)), np.empty(k)
    outward = np.empty(3)
    for i in range(k):
        distance, _ = closest_point(shape, (tips[i] - position) @ rotation, outward)
        normal = -(rotation @ outward)
        points[i] = tips[i] + radii[i] * normal
        frames[i] = contact_frame(normal)
        gaps[i] = distance - radii[i]
    return points, frames, gaps


@compiled
def observed(
    shape: Shape, position: Array, rotation: Array, tips: Array, radii: Array, past: Past
) -> tuple[Array, Array, Array, Array]:
    """Return contact points, frames and gaps as `contact_geometry`, NaN where nothing touches.

    The last are the impulses of the last step in these frames, shape (k, 3), N s.

    Args:
        shape: The object.
        position: Its centre of mass, palm frame, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        tips: Fingertip centres, palm frame, shape (k, 3), m.
        radii: Fingertip radii, shape (k,), m.
        past: The last step: what is pushed touches, whatever rounding makes of its gap.
    """
    points, frames, gaps = contact_geometry(shape, position, rotation, tips, radii)
    impulses, m = past.impulses.copy(), past.rows.shape[2] - 6
    for i in range(len(gaps)):
        if impulses[i, 1] > 0.0:
            impulses[i] = carried(frames[i].T, past.rows[i, :, m:], impulses[i])
        elif gaps[i] > TOUCH:
            points[i] = np.nan
            frames[i] = np.nan
    return points, frames, gaps, impulses


@compiled
def velocity_map(hand: HandTerms, position: Array, points: Array, frames: Array) -> Array:
    """Return A with w = A [theta'; v_o; w_o], object against tip in contact frames, (k, 3, m + 6).

    Its hand part is -R_C^T J_h and its object part R_C^T G^T with G of (4), equation (6).
    """
    k, m = hand.support.shape
    tips = Fingertips(hand.tips, *tip_jacobians(hand.spatial, hand.support, hand.tips))
    out = np.empty((k, 3, m + 6))
    out[:, :, :m] = -hand_jacobian(tips, points, frames)
    out[:, :, m:] = grasp_map(points - position, frames).T.reshape(k, 3, 6)
    return out


@compiled
def step(
    h: float, v: Array, hand: HandTerms, body: Body, shape: Shape, friction: Array, past: Past
) -> StepResult:
    """Advance velocities by a step h, in s, so that the contact laws hold at its end.

    The impulses of hand (3) and object (5) are those with which their velocities meet (6) in the
    contacts that stick, and Coulomb's law in the others.

    Args:
        h: Length of the step, s.
        v: Joint rates, velocity and spin of the object at its start, shape (m + 6,).
        hand: The hand half a step ahead.
        body: The object at its start.
        shape: Shape of the object.
        friction: Coulomb friction of each finger, shape (k,).
        past: What is known of the step before.
    """
    k, m = hand.support.shape
    position, rotation = _moved(body.position, body.rotation, 0.5 * h, v[m:])
    points, frames, gaps = contact_geometry(shape, position, rotation, hand.tips, hand.radii)
    every = velocity_map(hand, position, points, frames)
    turning, slid = _since(h, v, every, past)
    near = np.flatnonzero(gaps < NEAR)
    c = len(near)
    rows, mu, start = np.empty((3 * c, m + 6)), np.empty(c), np.empty((c, 3))
    closing, turn = np.empty(c), np.empty(3 * c)
    for i in range(c):
        j = near[i]
        rows[3 * i : 3 * i + 3], turn[3 * i : 3 * i + 3] = every[j], turning[j]
        mu[i], closing[i] = friction[j], _closing(gaps[j], h)
        start[i] = carried(every[j, :, m:], past.rows[j, :, m:], past.impulses[j])
    inverse_times, free = _response(h, v, hand, body, rotation, rows)
    impulses, sliding, residual, outcome = np.zeros((k, 3)), np.zeros((k, 2)), 0.0, EXACT
    settled, struck = np.zeros(k, dtype=np.bool_), False
    if c > 0:
        delassus, before = rows @ inverse_times, rows @ free
        solved = solve_contacts(delassus, before + turn, closing, mu, start)
        struck = _strikes(solved.impulses, near, past.settled)
        if (struck or solved.outcome != EXACT) and turn.any():
            # How contacts turned before says nothing of how they do now.
            solved = solve_contacts(delassus, before, closing, mu, start)
        free = free + inverse_times @ solved.impulses.copy().reshape(-1)
        for i in range(c):
            j = near[i]
            impulses[j] = solved.impulses[i]
            sliding[j, 0], sliding[j, 1] = solved.velocities[i, 0], solved.velocities[i, 2]
            settled[j] = impulses[j, 1] > 0.0 and abs(gaps[j]) < TOUCH
        residual, outcome = solved.residual, solved.outcome
    theta = hand.theta + 0.5 * h * (v[:m] + free[:m])
    position, rotation = _moved(position, rotation, 0.5 * h, free[m:])
    # Back onto the rotations, before rounding errors of many products add up: one step of Newton's
    # iteration to the nearest rotation (Higham 1986).
    rotation = 1.5 * rotation - 0.5 * (rotation @ (rotation.T @ rotation))
    following = Past(free if struck else v, every, impulses, settled, slid)
    return StepResult(theta, free, position, rotation, sliding, following, residual, outcome)


@compiled
def _since(h: float, v: Array, rows: Array, past: Past) -> tuple[Array, Array]:
    """Compare contacts with those of the last step, from whose middle to this one's v led.

    Returns:
        The turning (A - A_before) v / 2, shape (k, 3), m/s, by which A v grows until the end of the
        step, zero for contacts that have just closed, and the distance slid, shape (k,), m.
    """
    k, m = len(rows), len(v) - 6
    turning, slid = np.zeros((k, 3)), past.slid.copy()
    for i in range(k):
        if past.impulses[i, 1] <= 0.0:
            continue
        now, then = rows[i] @ v, carried(rows[i, :, m:], past.rows[i, :, m:], past.rows[i] @ v)
        if past.settled[i]:
            turning[i] = 0.5 * (now - then)
        slid[i] += 0.5 * h * np.hypot(now[0] + then[0], now[2] + then[2])
    return turning, slid


@compiled
def carried(now: Array, then: Array, vector: Array) -> Array:
    """Return a vector in the axes that a contact has now, shape (3,).

    The parts along the normal and across it stay; the tangents, which follow the palm's z axis, may
    have turned about the normal by any angle since then.

    Args:
        now: The axes of the contact frame as rows, palm axes, shape (3, 3 or more).
        then: The same at a time shortly before.
        vector: In the axes of then, shape (3,).
    """
    c, s = 0.0, 0.0
    for a in range(3):
        c += now[0, a] * then[0, a] + now[2, a] * then[2, a]
        s += now[0, a] * then[2, a] - now[2, a] * then[0, a]
    length = np.hypot(c, s)
    if length == 0.0:
        return vector.copy()
    c, s = c / length, s / length
    x, n, z = vector
    return np.array([c * x + s * z, n, c * z - s * x])


@compiled
def _closing(gap: float, h: float) -> float:
    """Return the speed at which a gap may close within a step, or a penetration must be left."""
    return gap / h if gap > 0.0 else max(_RECOVERY * gap / h, -_FASTEST_RECOVERY)


@compiled
def _strikes(impulses: Array, near: NDArray[np.intp], settled: NDArray[np.bool_]) -> bool:
    """Return whether a contact is pushed that was not closed and pushed before."""
    for i in range(len(near)):
        if impulses[i, 1] > 0.0 and not settled[near[i]]:
            return True
    return False


@compiled
def _moved(position: Array, rotation: Array, h: float, v: Array) -> tuple[Array, Array]:
    """Return position and rotation after a time h at a velocity and spin v, shape (6,)."""
    turn = rodrigues(h * v[3], h * v[4], h * v[5])
    return position + h * v[:3], turn @ rotation


@compiled
def _response(
    h: float, v: Array, hand: HandTerms, body: Body, rotation: Array, rows: Array
) -> tuple[Array, Array]:
    """Return M^-1 A^T, shape (m + 6, 3c), and the velocities without contact, (m + 6,)."""
    m, c = len(hand.theta), len(rows)
    turning = rotation @ body.inertia @ rotation.T
    spin = body.spin
    momentum = turning @ spin
    right = np.empty((m + 6, c + 1))
    right[:, :c] = rows.T
    right[:m, c] = h * (hand.torque - hand.bias)
    right[m : m + 3, c] = h * body.wrench[:3]
    right[m + 3, c] = h * (body.wrench[3] - spin[1] * momentum[2] + spin[2] * momentum[1])
    right[m + 4, c] = h * (body.wrench[4] - spin[2] * momentum[0] + spin[0] * momentum[2])
    right[m + 5, c] = h * (body.wrench[5] - spin[0] * momentum[1] + spin[1] * momentum[0])
    substitute(factorize(hand.inertia)[0], right[:m])
    right[m : m + 3] /= body.mass
    substitute(factorize(turning)[0], right[m + 3 :])
    return right[:, :c].copy(), v + right[:, c]
