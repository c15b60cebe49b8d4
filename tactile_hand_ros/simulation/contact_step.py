# SPDX-License-Identifier: Apache-2.0
"""One step of hand, object and contacts, on arrays; see `plant`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.cholesky import factorize, substitute
from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import contact_frame, hand_jacobian
from tactile_hand_ros.control.grasp import grasp_map
from tactile_hand_ros.hand.hand import Dynamics, Fingertips
from tactile_hand_ros.rotations import cross, rodrigues
from tactile_hand_ros.simulation.coulomb import EXACT, ContactImpulses, solve_contacts
from tactile_hand_ros.simulation.solid import Shape, closest_point

TOUCH = 1e-6  # gap below which a finger counts as touching, m
NEAR = 2e-3  # gap below which a contact is part of the problem of a step, m
_SHEAR = 1.5  # tangential per normal compliance of an incompressible tip (Mindlin 1949)
_RECOVERY = 0.2  # fraction of a penetration that a step removes
_CREEP = 1e-6  # of the spin that a moment alone causes: opposed moments have one answer
_FASTEST_RECOVERY = 5e-3  # m/s, its largest speed, so that the object does not fly off


class World(NamedTuple):
    """Constants of hand and object.

    Attributes:
        radii: Fingertip radii, shape (k,), m.
        shape: Shape of the object.
        mass: Its mass, kg.
        inertia: Its inertia in its own frame, shape (3, 3), kg m^2.
        compliance: Indentation of a soft fingertip per normal force, m/N.
        torsion: Largest moment about the normal per largest friction force, m.
    """

    radii: Array
    shape: Shape
    mass: float
    inertia: Array
    compliance: float = 0.0
    torsion: float = 0.0


class Motion(NamedTuple):
    """Hand and object at one instant, and the results of the last step.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        velocities: Joint rates, velocity and spin of the object, shape (m + 6,).
        position: Center of mass, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        before: The velocities one step earlier, shape (m + 6,).
        rows: A of `velocity_map` half a step earlier, shape (k, 3 or 4, m + 6).
        impulses: Impulses of the step on the object in contact frames, shape (k, 3 or 4), N s; see
            `coulomb`.
        sliding: Tangential velocities of the object against the loaded tips (x, z), shape (k, 2),
            m/s.
        settled: Which contacts were closed and loaded already, without an impact, shape (k,).
        slid: Distance that each contact has slid since the start, shape (k,), m.
        residual: Largest relative violation of the contact laws in the step.
        outcome: EXACT, RELAXED or UNSOLVED of `coulomb`.
    """

    theta: Array
    velocities: Array
    position: Array
    rotation: Array
    before: Array
    rows: Array
    impulses: Array
    sliding: Array
    settled: NDArray[np.bool_]
    slid: Array
    residual: float
    outcome: int


def at_rest(
    theta: Array, position: Array, rotation: Array, fingers: int, torsion: float = 0.0
) -> Motion:
    """Return the initial `Motion` at joint angles, shape (m,), rad, and a pose of the object."""
    k, d, still = fingers, 4 if torsion > 0.0 else 3, np.zeros(len(theta) + 6)
    past = np.zeros((k, d, len(still))), np.zeros((k, d)), np.zeros((k, 2))
    settled = np.zeros(k, dtype=np.bool_)
    return Motion(theta, still, position, rotation, still, *past, settled, np.zeros(k), 0.0, EXACT)


@compiled
def half_step(h: float, now: Motion) -> tuple[Array, Array]:
    """Return joint angles and velocities after half a step h, s; bias forces need both."""
    v = now.velocities
    return now.theta + 0.5 * h * v[: len(now.theta)], v + 0.5 * (v - now.before)


@compiled
def contact_geometry(
    world: World, position: Array, rotation: Array, tips: Array
) -> tuple[Array, Array, Array]:
    """Return the contact, or the closest point, of each fingertip.

    Position and rotation are those of the object and `tips` the fingertip centers, shape (k, 3), m,
    all in the palm frame.

    Returns:
        Points on the fingertips p_c = p_f + r n, shape (k, 3), contact frames, shape (k, 3, 3), and
        gaps, shape (k,), m.
    """
    k = len(tips)
    points, frames, gaps = np.empty((k, 3)), np.empty((k, 3, 3)), np.empty(k)
    for i in range(k):
        distance, outward = closest_point(world.shape, (tips[i] - position) @ rotation)
        normal = -(rotation @ outward)
        points[i] = tips[i] + world.radii[i] * normal
        frames[i] = contact_frame(normal)
        gaps[i] = distance - world.radii[i]
    return points, frames, gaps


@compiled
def observed(world: World, now: Motion, tips: Array) -> tuple[Array, Array, Array, Array]:
    """Return `contact_geometry`, NaN without a contact, and the last impulses of `Motion`.

    A loaded fingertip touches, whatever the rounding of its gap. Impulses are in these frames.
    """
    points, frames, gaps = contact_geometry(world, now.position, now.rotation, tips)
    impulses, m = now.impulses.copy(), len(now.theta)
    for i in range(len(gaps)):
        if impulses[i, 1] > 0.0:
            impulses[i] = carried(frames[i].T, now.rows[i, :, m:], impulses[i])
        elif gaps[i] > TOUCH:
            points[i] = np.nan
            frames[i] = np.nan
    return points, frames, gaps, impulses


@compiled
def velocity_map(
    tips: Fingertips, position: Array, points: Array, frames: Array, torsion: float
) -> Array:
    """Return A with w = A [theta'; v_o; w_o], object against tip in contact frames.

    Its hand part is -R_C^T J_h and its object part R_C^T G^T with G of (4), equation (6), of shape
    (k, 3, m + 6). With a torsion, m, a fourth row is that times the relative spin about the normal.
    """
    k, _, m = tips.linear.shape
    out = np.zeros((k, 4 if torsion > 0.0 else 3, m + 6))
    out[:, :3, :m] = -hand_jacobian(tips, points, frames)
    out[:, :3, m:] = grasp_map(points - position, frames).T.reshape(k, 3, 6)
    if torsion > 0.0:
        for i in range(k):
            normal = torsion * frames[i, :, 1].copy()
            out[i, 3, :m] = -(normal @ tips.angular[i])
            out[i, 3, m + 3 :] = normal
    return out


@compiled
def step(
    h: float,
    now: Motion,
    world: World,
    friction: Array,
    hand: Dynamics,
    torque: Array,
    wrench: Array,
) -> Motion:
    """Return hand (3) and object (5) a step h, s, later, under the contact laws.

    Contacts that stick obey (6), the others Coulomb's law.

    Args:
        h: Length of the step, s.
        now: Hand and object at its start.
        world: Object and fingertips.
        friction: Coulomb friction of each finger, shape (k,).
        hand: The hand half a step ahead.
        torque: tau, shape (m,), N m.
        wrench: External wrench and weight about the object's center of mass, shape (6,), N and N m.
    """
    k, _, m = hand.tips.linear.shape
    v = now.velocities
    position, rotation = moved(now.position, now.rotation, 0.5 * h, v[m:])
    points, frames, gaps = contact_geometry(world, position, rotation, hand.tips.positions)
    every = velocity_map(hand.tips, position, points, frames, world.torsion)
    turning, slid = _since(h, now, every)
    near = np.flatnonzero(gaps < NEAR)
    c, d = len(near), every.shape[1]
    rows = every[near].reshape(d * c, m + 6)
    forces = np.concatenate((torque - hand.bias, wrench))
    inverse_times, free = _response(h, now, world, hand.inertia, forces, rotation, rows)
    impulses, sliding, residual, outcome = np.zeros((k, d)), np.zeros((k, 2)), 0.0, EXACT
    settled, struck = np.zeros(k, dtype=np.bool_), False
    if c > 0:
        motion = rows @ inverse_times, rows @ free, turning[near].reshape(d * c)
        solved, struck = _solved(h, now, world, near, gaps[near], every, motion, friction[near])
        free = free + inverse_times @ solved.impulses.copy().reshape(-1)
        for i in range(c):
            j = near[i]
            impulses[j] = solved.impulses[i]
            if impulses[j, 1] > 0.0:
                sliding[j] = solved.velocities[i, :3:2]
            if world.compliance > 0.0:  # the rest of the motion is elastic
                slid[j] = now.slid[j] + h * np.hypot(sliding[j, 0], sliding[j, 1])
            indentation = world.compliance * impulses[j, 1] / h
            settled[j] = impulses[j, 1] > 0.0 and abs(gaps[j] + indentation) < TOUCH
        residual, outcome = solved.residual, solved.outcome
    theta = now.theta + 0.5 * h * (v[:m] + free[:m])
    position, rotation = moved(position, rotation, 0.5 * h, free[m:])
    # One step of Newton's iteration to the nearest rotation (Higham 1986), against rounding errors.
    rotation = 1.5 * rotation - 0.5 * (rotation @ (rotation.T @ rotation))
    contacts = every, impulses, sliding, settled, slid, residual, outcome
    return Motion(theta, free, position, rotation, free if struck else v, *contacts)


@compiled
def _solved(
    h: float,
    now: Motion,
    world: World,
    near: NDArray[np.intp],
    gaps: Array,
    every: Array,
    motion: tuple[Array, Array, Array],
    friction: Array,
) -> tuple[ContactImpulses, bool]:
    """Return the impulses of the contacts that are near, and whether one has just struck.

    The motion is W, the velocities without impulses, and their growth by the turning contacts.
    """
    (delassus, before, turn), m = motion, len(now.theta)
    c, d = len(near), every.shape[1]
    start, closing = np.empty((c, d)), np.empty(c)
    for i in range(c):
        j = near[i]
        closing[i] = gaps[i] / h  # what may close in a step, or of a penetration must open
        if gaps[i] < 0.0 and world.compliance == 0.0:
            closing[i] = max(_RECOVERY * gaps[i] / h, -_FASTEST_RECOVERY)
        start[i] = carried(every[j, :, m:], now.rows[j, :, m:], now.impulses[j])
        if world.compliance == 0.0 and d == 4:
            delassus[d * i + 3, d * i + 3] *= 1.0 + _CREEP
    if world.compliance > 0.0:
        # Implicit springs: the gap after the step is -compliance p_n / h. Those of tangential
        # impulses start with the last step, so that the solution's velocities are slip alone.
        softness = world.compliance / h**2
        for i in range(c * d):
            soft = softness if i % d == 1 else _SHEAR * softness
            delassus[i, i] += soft
            if i % d != 1:
                before[i] -= soft * start[i // d, i % d]
    solved = solve_contacts(delassus, before + turn, closing, friction, start)
    struck = bool(((solved.impulses[:, 1] > 0.0) & ~now.settled[near]).any())
    if (struck or solved.outcome != EXACT) and turn.any():
        # The last turning does not apply to an impact.
        solved = solve_contacts(delassus, before, closing, friction, start)
    return solved, struck


@compiled
def _since(h: float, now: Motion, rows: Array) -> tuple[Array, Array]:
    """Compare contacts with those of the last step, half a step earlier and later.

    Return the growth (A - A_before) v / 2 of A v, shape (k, 3 or 4), m/s, zero for contacts that
    have just closed, and the distance slid, shape (k,), m.
    """
    v, m = now.velocities, len(now.theta)
    turning, slid = np.zeros(now.impulses.shape), now.slid.copy()
    for i in np.flatnonzero(now.impulses[:, 1] > 0.0):
        here, before = rows[i] @ v, now.rows[i]
        there = carried(rows[i, :, m:], before[:, m:], before @ v)
        if now.settled[i]:
            turning[i] = 0.5 * (here - there)
        slid[i] += 0.5 * h * np.hypot(here[0] + there[0], here[2] + there[2])
    return turning, slid


@compiled
def carried(now: Array, then: Array, vector: Array) -> Array:
    """Return a vector in the axes that a contact has now, from those shortly before.

    The tangents, which follow the palm's z axis, may have turned about the normal. Axes are rows,
    palm axes, shape (3, 3 or more); the vector has shape (3,), or (4,) with a moment.
    """
    c, s = 0.0, 0.0
    for a in range(3):
        c += now[0, a] * then[0, a] + now[2, a] * then[2, a]
        s += now[0, a] * then[2, a] - now[2, a] * then[0, a]
    length, out = np.hypot(c, s), vector.copy()
    if length == 0.0:
        return out
    c, s = c / length, s / length
    out[0], out[2] = c * vector[0] + s * vector[2], c * vector[2] - s * vector[0]
    return out


@compiled
def moved(position: Array, rotation: Array, h: float, v: Array) -> tuple[Array, Array]:
    """Return position and rotation after a time h at a velocity and spin v, shape (6,)."""
    turn = rodrigues(h * v[3], h * v[4], h * v[5])
    return position + h * v[:3], turn @ rotation


@compiled
def _response(
    h: float, now: Motion, world: World, inertia: Array, forces: Array, rotation: Array, rows: Array
) -> tuple[Array, Array]:
    """Return M^-1 A^T, shape (m + 6, 3c), and the velocities without contact, (m + 6,)."""
    m, c = len(now.theta), len(rows)
    turning = rotation @ world.inertia @ rotation.T
    spin = half_step(h, now)[1][m + 3 :]
    forces[m + 3 :] -= np.array(cross(spin, turning @ spin))  # the gyroscopic torque
    right = np.empty((m + 6, c + 1))
    right[:, :c] = rows.T
    right[:, c] = h * forces
    substitute(factorize(inertia)[0], right[:m])
    right[m : m + 3] /= world.mass
    substitute(factorize(turning)[0], right[m + 3 :])
    return right[:, :c].copy(), now.velocities + right[:, c]
