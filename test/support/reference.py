# SPDX-License-Identifier: Apache-2.0
"""A second, independent computation of the paper's motion: (2) to (6) as an ODE.

It shares no code with the plant, so a bug in the plant's contact Jacobian or grasp map shows as a
difference. All contacts stick on faces of the object, so that (6) always holds; its derivative,
with the contact point moving on both bodies, closes the system:

    p_c = p_f - r n,  rho = p_c - p_f = -r n,  n fixed in the object:  rho' = w_o x rho
    0 = d/dt [ v_f + w_f x rho - v_o - w_o x (p_c - p_o) ]
      = a_f + al_f x rho + w_f x rho' - a_o - al_o x (p_c - p_o) - w_o x (v_f + rho' - v_o)

The constraint is not stabilized: the tolerance of the Dormand-Prince 8(5,3) method keeps its drift
at the level of rounding errors, which the tests check.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]


class World(NamedTuple):
    """The reference's model of hand and object."""

    urdf: str  # text of the hand's URDF
    tips: list[str]  # names of the fingertips' links
    radii: Array  # of the fingertips, shape (k,), m
    mass: float  # of the object, kg
    inertia: Array  # of the object in its own frame, shape (3, 3), kg m^2
    gravity: Array  # acceleration, palm frame, shape (3,), m/s^2
    faces: Array  # outward normals in the object's frame, one per finger, shape (k, 3)


class State(NamedTuple):
    """Joints, object position, quaternion (x, y, z, w) and their rates, palm frame, SI units."""

    theta: Array
    rates: Array
    position: Array
    quaternion: Array
    velocity: Array
    spin: Array


class Reference:
    """Integrates the sticking grasp with an adaptive method of order eight."""

    def __init__(self, world: World) -> None:
        """Build the hand's model."""
        self.world = world
        self.model = pin.buildModelFromXML(world.urdf)
        self.model.gravity.linear = world.gravity
        self.data = self.model.createData()
        self.frames = [self.model.getFrameId(t) for t in world.tips]
        self.m = self.model.nv

    def unpack(self, y: Array) -> State:
        """Return a vector as a state."""
        m = self.m
        parts = np.split(y, np.cumsum([m, m, 3, 4, 3]))
        return State(*parts)

    def solve_rates(self, y: Array, torque: Array, wrench: Array) -> tuple[Array, Array]:
        """Return y' and the contact forces on the object, shape (k, 3), palm axes."""
        s, w, m, k = self.unpack(y), self.world, self.m, len(self.frames)
        hand, solid, bias = self.contact_rows(s)
        rotation = rotation_of(s)
        inertia = rotation @ w.inertia @ rotation.T
        mass = np.triu(self.data.M) + np.triu(self.data.M, 1).T
        force_o = np.concatenate([w.mass * w.gravity, -np.cross(s.spin, inertia @ s.spin)]) + wrench
        # M_h th'' + J_h^T f = tau - ..., M_o x'' - G f = w_e
        n = m + 6
        lhs = np.zeros((n + 3 * k, n + 3 * k))
        lhs[:m, :m] = mass
        lhs[m : m + 3, m : m + 3] = w.mass * np.eye(3)
        lhs[m + 3 : n, m + 3 : n] = inertia
        constraint = np.hstack([hand, -solid])
        lhs[n:, :n], lhs[:n, n:] = constraint, constraint.T
        rhs = np.concatenate([torque - self.data.nle, force_o, -bias])
        solution = np.linalg.solve(lhs, rhs)
        vector, scalar = s.quaternion[:3], s.quaternion[3]
        turn = 0.5 * np.append(scalar * s.spin + np.cross(s.spin, vector), -s.spin @ vector)
        y_dot = np.concatenate(
            [s.rates, solution[:m], s.velocity, turn, solution[m : m + 3], solution[m + 3 : n]]
        )
        return y_dot, solution[n:].reshape(k, 3)

    def contact_rows(self, s: State) -> tuple[Array, Array, Array]:
        """Return the contact constraint on the accelerations.

        J_h of (2), (3k, m), for the joints; a factor for the object, (3k, 6); the rest, m/s^2.
        """
        w, m, k, rotation = self.world, self.m, len(self.frames), rotation_of(s)
        pin.computeAllTerms(self.model, self.data, s.theta, s.rates)
        pin.forwardKinematics(self.model, self.data, s.theta, s.rates, np.zeros(m))
        pin.updateFramePlacements(self.model, self.data)
        hand, solid, bias = np.zeros((3 * k, m)), np.zeros((3 * k, 6)), np.zeros(3 * k)
        axes = pin.LOCAL_WORLD_ALIGNED
        for i, frame in enumerate(self.frames):
            jac = pin.getFrameJacobian(self.model, self.data, frame, axes)
            acc = pin.getFrameClassicalAcceleration(self.model, self.data, frame, axes)
            vel = pin.getFrameVelocity(self.model, self.data, frame, axes)
            p_f = self.data.oMf[frame].translation
            rho = -w.radii[i] * (rotation @ w.faces[i])
            d = p_f + rho - s.position
            rows = slice(3 * i, 3 * i + 3)
            hand[rows] = jac[:3] - pin.skew(rho) @ jac[3:]
            solid[rows] = np.hstack([np.eye(3), -pin.skew(d)])
            rho_dot = np.cross(s.spin, rho)
            bias[rows] = (
                acc.linear
                + np.cross(acc.angular, rho)
                + np.cross(vel.angular, rho_dot)
                - np.cross(s.spin, vel.linear + rho_dot - s.velocity)
            )
        return hand, solid, bias

    def contacts(self, y: Array) -> Array:
        """Return the contact points, shape (k, 3), palm frame."""
        s = self.unpack(y)
        pin.framesForwardKinematics(self.model, self.data, s.theta)
        tips = np.array([self.data.oMf[f].translation for f in self.frames])
        normals = self.world.faces @ rotation_of(s).T
        return np.asarray(tips - self.world.radii[:, None] * normals)

    def run(
        self,
        start: State,
        control: Callable[[float, State, Array], Array],
        times: Array,
        wrench: Array | None = None,
        rtol: float = 1e-9,
    ) -> tuple[Array, Array]:
        """Integrate over `times` and return states (len(times), n) and forces at them."""
        external = np.zeros(6) if wrench is None else wrench
        states = [np.concatenate(start)]

        def rates_and_forces(t: float, y: Array) -> tuple[Array, Array]:
            torque = control(t, self.unpack(y), self.contacts(y))
            return self.solve_rates(y, torque, external)

        def rates(t: float, y: Array) -> Array:
            return rates_and_forces(t, y)[0]

        for way in itertools.pairwise(times):
            found = solve_ivp(rates, way, states[-1], method="DOP853", rtol=rtol, atol=1e-12)
            states.append(found.y[:, -1])
        forces = [rates_and_forces(t, y)[1] for t, y in zip(times, states, strict=True)]
        return np.array(states), np.array(forces)


def rotation_of(s: State) -> Array:
    """Return the rotation of the object, shape (3, 3)."""
    return pin.Quaternion(s.quaternion / np.linalg.norm(s.quaternion)).toRotationMatrix()
