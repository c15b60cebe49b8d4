# SPDX-License-Identifier: Apache-2.0
"""The plant: hand (3), object (5) and unilateral, frictional, rolling contact between them.

One step follows Moreau's midpoint rule (Moreau 1988): the geometry is taken half a step ahead,
the velocities after the step obey the contact laws there, and positions move with the mean of the
velocities before and after. The contact point p_c = p_f + r n is found anew at each step, so that
it moves over both bodies as the fingertip rolls; the acceleration form of (6) is never needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tactile_hand_ros.core.contact import Contacts, contact_frame
from tactile_hand_ros.core.coulomb import solve_contacts
from tactile_hand_ros.core.disturbance import external_wrench
from tactile_hand_ros.core.errors import ConfigurationError, ObjectModelError
from tactile_hand_ros.core.hand import Fingertips, Hand
from tactile_hand_ros.core.plant_config import PlantConfig
from tactile_hand_ros.core.rotations import (
    cross,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
)

Array = NDArray[np.float64]

TOUCH = 1e-6  # gap below which a finger counts as touching, m
_NEAR = 2e-3  # gap below which a contact is part of the problem of a step, m
_REACH = 5e-3  # initial gap that `reset` closes by moving the fingers, m
_RECOVERY = 0.2  # share of a penetration that is removed in a step


@dataclass(frozen=True)
class PlantState:
    """Hand and object at one instant; vectors in palm axes unless they are in contact frames.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        rates: Joint rates, shape (m,), rad/s.
        torque: Torque that acted on the joints, shape (m,), N m.
        position: Object's centre of mass, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        velocity: Velocity of the centre of mass, shape (3,), m/s.
        spin: Angular velocity, shape (3,), rad/s.
        contacts: Contact points and frames; NaN where a finger does not touch.
        forces: Contact forces on the object in contact frames, shape (k, 3), N.
        sliding: Tangential velocities of the object against the tips (x, z), shape (k, 2), m/s.
        gaps: Distances of the fingertips from the object, shape (k,), m.
    """

    theta: Array
    rates: Array
    torque: Array
    position: Array
    rotation: Array
    velocity: Array
    spin: Array
    contacts: Contacts
    forces: Array
    sliding: Array
    gaps: Array


@dataclass(frozen=True)
class _Geometry:
    """Contact geometry of all fingers at one configuration."""

    points: Array
    frames: Array
    gaps: Array


class Plant:
    """A hand that holds an object; `advance` moves both in time."""

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object and put them at their start.

        Raises:
            HandModelError: If the hand cannot be built.
            ObjectModelError: If the object has no volume or the fingers start inside it.
            ConfigurationError: If the number of initial joint angles is wrong.
        """
        self.config = config
        self.hand = Hand.load(config.hand, config.layout, np.array(config.gravity))
        self.solid = config.object.solid()
        self._mass = config.object.mass
        self._inertia = np.diag(config.object.inertia)
        self._gravity = np.array(config.gravity)
        self._initial_joints = self._expand(config.initial_joints)
        self.friction = np.full(self.hand.fingers, config.object.friction)
        self.reset()

    def _expand(self, given: list[float]) -> Array:
        m, k = self.hand.joints, self.hand.fingers
        if len(given) == m:
            return np.array(given)
        if len(given) * k == m:
            return np.tile(given, k)
        raise ConfigurationError(
            f"initial_joints has {len(given)} angles; expected {m}, one per joint"
            + (f", or {m // k} for every finger alike" if m % k == 0 else ""),
            place="initial_joints",
        )

    def reset(self) -> PlantState:
        """Put hand and object at their start, at rest, with the fingers touching."""
        c = self.config.object
        self.time = 0.0
        self._steps = 0
        self._theta = self._initial_joints.copy()
        self._v = np.zeros(self.hand.joints + 6)
        self._position = np.array(c.position)
        self._rotation = rotation_from_vector(c.rotation)
        self._close_gaps()
        k = self.hand.fingers
        self._torque = np.zeros(self.hand.joints)
        self._impulses = np.zeros((k, 3))
        self._guess = np.zeros((k, 3))
        self.contact_residual = 0.0
        self._sliding = np.zeros((k, 2))
        return self.state

    def _close_gaps(self) -> None:
        """Move the fingers so that tips within 5 mm of the object touch it exactly."""
        for _ in range(20):
            tips = self.hand.fingertips(self._theta)
            g = self._geometry(tips, self._position, self._rotation)
            if g.gaps.min() < -_REACH:
                finger = self.hand.finger_names[int(g.gaps.argmin())]
                raise ObjectModelError(
                    f"{finger} starts {-1e3 * g.gaps.min():.1f} mm inside the object; open the "
                    "hand (initial_joints), move the object or make it smaller"
                )
            missing = np.where(np.abs(g.gaps) <= _REACH, g.gaps, 0.0)
            if np.abs(missing).max() < 1e-15:
                return
            moves = g.frames[:, :, 1] * missing[:, None]
            jacobian = tips.linear.reshape(-1, self.hand.joints)
            self._theta += np.linalg.lstsq(jacobian, moves.ravel(), rcond=1e-6)[0]

    def _geometry(self, tips: Fingertips, position: Array, rotation: Array) -> _Geometry:
        closest = self.solid.closest((tips.positions - position) @ rotation)
        normals = np.array([c.normal for c in closest]) @ -rotation.T  # into the object
        points = tips.positions + self.hand.radii[:, None] * normals
        frames = np.array([contact_frame(n) for n in normals])
        return _Geometry(points, frames, np.array([c.distance for c in closest]) - self.hand.radii)

    def advance(self, torque: Array) -> PlantState:
        """Move one tick ahead while the joints keep a torque, shape (m,), N m.

        The torque is limited to the joints' effort limits, as a motor would.
        """
        limit = self.hand.effort_limits
        self._torque = np.clip(torque, -limit, limit)
        for _ in range(self.config.steps_per_tick):
            self._step(self.config.time_step)
        # Back onto the rotations, before rounding errors of many products add up.
        self._rotation = rotation_from_quaternion(quaternion_from_rotation(self._rotation))
        return self.state

    def _step(self, h: float) -> None:
        m, v = self.hand.joints, self._v
        theta, position, rotation = self._moved(0.5 * h, v)
        tips, inertia, bias = self.hand.dynamics(theta, v[:m])
        g = self._geometry(tips, position, rotation)
        near = np.flatnonzero(g.gaps < _NEAR)
        rows = self._velocity_map(tips, g, position)[near].reshape(-1, m + 6)
        inverse_times, free = self._response(h, inertia, bias, rotation, rows)
        self._impulses[:] = 0.0
        self._sliding[:] = 0.0
        if len(near):
            # The gap at the start of the step, from the one half a step ahead.
            gaps = g.gaps[near] - 0.5 * h * (rows[1::3] @ v)
            closing = np.where(gaps > 0.0, gaps, _RECOVERY * gaps) / h
            solved = solve_contacts(
                rows @ inverse_times, rows @ free, closing, self.friction[near], self._guess[near]
            )
            free = free + inverse_times @ solved.impulses.ravel()
            self._impulses[near] = solved.impulses
            self._sliding[near] = solved.velocities[:, [0, 2]]
            self.contact_residual = solved.residual
        self._guess = self._impulses.copy()
        self._theta, self._position, self._rotation = self._moved(h, 0.5 * (v + free))
        self._v = free
        self._steps += 1
        self.time = self._steps * h

    def _moved(self, h: float, v: Array) -> tuple[Array, Array, Array]:
        """Return joints, object position and rotation after a time h at velocity v."""
        m = self.hand.joints
        return (
            self._theta + h * v[:m],
            self._position + h * v[m : m + 3],
            rotation_from_vector(h * v[m + 3 :]) @ self._rotation,
        )

    def _velocity_map(self, tips: Fingertips, g: _Geometry, position: Array) -> Array:
        """Return A with w = A [theta'; v_o; w_o], object against tip in contact frames.

        Its hand part is -R_C^T J_h and its object part R_C^T G^T, equation (6). In a contact frame
        p_cf = r e_y, and w x e_y = (-w_z, 0, w_x).
        """
        m = self.hand.joints
        to_frame = g.frames.transpose(0, 2, 1)
        out = np.empty((len(g.points), 3, m + 6))
        linear, angular = to_frame @ tips.linear, to_frame @ tips.angular
        angular *= self.hand.radii[:, None, None]
        out[:, :, :m] = -linear
        out[:, 0, :m] += angular[:, 2]
        out[:, 2, :m] -= angular[:, 0]
        out[:, :, m : m + 3] = to_frame
        # R_C^T (w x d) = (d x t) . w for each axis t of the frame
        dx, dy, dz = (g.points - position).T[:, :, None]
        tx, ty, tz = to_frame.transpose(2, 0, 1)
        out[:, :, m + 3] = dy * tz - dz * ty
        out[:, :, m + 4] = dz * tx - dx * tz
        out[:, :, m + 5] = dx * ty - dy * tx
        return out

    def _response(
        self, h: float, inertia: Array, bias: Array, rotation: Array, rows: Array
    ) -> tuple[Array, Array]:
        """Return M^-1 A^T, shape (m + 6, 3c), and the velocities without contact, (m + 6,)."""
        m, v = self.hand.joints, self._v
        wrench = external_wrench(self.config.disturbances, self.time + 0.5 * h)
        spin = v[m + 3 :]
        turning = rotation @ self._inertia @ rotation.T
        right = np.empty((m + 6, rows.shape[0] + 1))
        right[:, :-1] = rows.T
        right[:m, -1] = h * (self._torque - bias)
        right[m : m + 3, -1] = h * (wrench[:3] + self._mass * self._gravity)
        right[m + 3 :, -1] = h * (wrench[3:] - cross(spin, turning @ spin))
        right[:m] = lapack.dposv(inertia, right[:m])[1]
        right[m : m + 3] /= self._mass
        right[m + 3 :] = lapack.dposv(turning, right[m + 3 :])[1]
        return right[:, :-1], v + right[:, -1]

    @property
    def state(self) -> PlantState:
        """Hand and object now."""
        m, h = self.hand.joints, self.config.time_step
        g = self._geometry(self.hand.fingertips(self._theta), self._position, self._rotation)
        open_ = (g.gaps > TOUCH) & (self._impulses[:, 1] <= 0.0)
        g.points[open_] = np.nan
        g.frames[open_] = np.nan
        return PlantState(
            self._theta.copy(),
            self._v[:m].copy(),
            self._torque.copy(),
            self._position.copy(),
            self._rotation.copy(),
            self._v[m : m + 3].copy(),
            self._v[m + 3 :].copy(),
            Contacts(g.points, g.frames),
            self._impulses / h,
            self._sliding.copy(),
            g.gaps,
        )

    def energy(self) -> float:
        """Return kinetic and potential energy of links and object in J."""
        m = self.hand.joints
        v, w = self._v[m : m + 3], self._rotation.T @ self._v[m + 3 :]
        body = 0.5 * self._mass * (v @ v) + 0.5 * w @ self._inertia @ w
        links = self.hand.kinetic_energy(self._theta, self._v[:m])
        height = -self._mass * (self._gravity @ self._position)
        return float(body + links + self.hand.potential_energy(self._theta) + height)
