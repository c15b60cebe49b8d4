# SPDX-License-Identifier: Apache-2.0
"""The plant: hand (3), object (5) and unilateral, frictional, rolling contact between them.

One step follows Moreau's midpoint rule (Moreau 1988). The geometry is half a step ahead, the
velocities after the step obey the contact laws there, and positions move with the mean of the
velocities before and after. Each step computes the contact point p_c = p_f + r n, so that it moves
over both bodies as the fingertip rolls, without the acceleration form of (6).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.errors import ConfigurationError, DivergedError, ObjectModelError
from tactile_hand_ros.hand.hand import Dynamics, Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import (
    quaternion_from_rotation,
    quaternions_of_rows,
    rotation_from_vector,
)
from tactile_hand_ros.simulation.contact_step import (
    Motion,
    World,
    at_rest,
    contact_geometry,
    half_step,
    moved,
    observed,
    step,
)
from tactile_hand_ros.simulation.coulomb import RELAXED, UNSOLVED
from tactile_hand_ros.simulation.joint_sensor import JointSensor
from tactile_hand_ros.simulation.palm_motion import (
    Turning,
    apparent_wrench,
    palm_turning,
    resting,
    turned_by,
    turned_by_user,
)
from tactile_hand_ros.simulation.plant_config import PlantConfig, external_wrench
from tactile_hand_ros.simulation.skin import TactileReading

_FASTEST = 1e4  # rad/s and m/s
_ENDLESS = 1e9  # times the largest inertia: that of a joint at its stop
_TRIALS = 3  # of rest and both directions of a joint that friction may slide in, for each joint
_SLACK = 1e-6  # of the largest friction, by which a joint at rest may exceed it
_REACH = 5e-3  # initial gap that `reset` closes by moving the fingers, m
_REACH_BY_TOUCH = 5e-2  # the same with a wrong calibration, where the hand closes by touch, m


class PlantState(NamedTuple):
    """Hand and object at one instant; vectors in palm axes unless they are in contact frames.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        rates: Joint rates, shape (m,), rad/s.
        joints: Report of the joints.
        position: Object's center of mass, shape (3,), m.
        rotation: Object frame in the palm frame, shape (3, 3).
        velocity: Velocity of the center of mass, shape (3,), m/s.
        spin: Angular velocity, shape (3,), rad/s.
        contacts: Contact points and frames; NaN where a finger does not touch.
        forces: Contact forces on the object in contact frames, shape (k, 3), N.
        sliding: Tangential velocities of the object against the tips (x, z), shape (k, 2), m/s.
        slid: Distance that each contact has slid since the start, shape (k,), m.
        gaps: Distances of the fingertips from the object, shape (k,), m.
        touch: Contacts and forces in the form of topics.
        speeds: Sliding speed of each contact, shape (k,), m/s.
        palm: Quaternion (x, y, z, w) of the palm in the world, shape (4,); None if it never turns.
    """

    theta: Array
    rates: Array
    joints: Joints
    position: Array
    rotation: Array
    velocity: Array
    spin: Array
    contacts: Contacts
    forces: Array
    sliding: Array
    slid: Array
    gaps: Array
    touch: TactileReading
    speeds: Array
    palm: Array | None = None


class Plant:
    """A hand that holds an object; `advance` moves both in time.

    Attributes:
        config: Its parameters.
        hand: The true hand.
        model: The hand of the controllers, the same with a correct calibration.
        solid: The object's shape.
        friction: Coulomb friction of each finger now, shape (k,).
        time: Simulated time, s.
        relaxed_steps: Steps since the start in which a penetration could not be removed.
        unsolved_steps: Steps since the start without a solution of the contact laws.
    """

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object in their initial state.

        Raises:
            HandModelError: If the hand cannot be built.
            ObjectModelError: If the object has no volume or the fingers start inside it.
            ConfigurationError: If the number of initial joint angles is wrong.
        """
        self.config = config
        self._gravity = np.array(config.gravity)
        self.hand = self.model = Hand.load(config.hand, config.layout, self._gravity)
        c = config.calibration
        if not c.is_right:
            self._gravity = rotation_from_vector(c.gravity_rotation) @ self._gravity
            true = config.hand, config.layout, self._gravity
            self.hand = Hand.load(*true, link_lengths=c.link_lengths, tip_radii=c.tip_radii)
        self.solid = config.object.solid()
        self._load_object()
        self._initial_joints = self._expand(config.initial_joints)
        self._joint_sensor = JointSensor(
            config.encoder, config.effort_noise, config.time_step, config.seed
        )
        self.reset()

    def configure(self, config: PlantConfig) -> None:
        """Change friction, mass and `palm_turn`, also for the time after a reset.

        Only a changed friction replaces that of the contacts, which `friction_changes` may set.
        """
        if config.object.friction != self.config.object.friction:
            self.friction[:] = config.object.friction
        self.config = config
        self._load_object()

    def _load_object(self) -> None:
        c, tip = self.config.object, self.config.contact
        body = c.mass, c.inertia_about(self.solid)
        self._world = World(self.hand.radii, self.solid.shape, *body, tip.compliance, tip.torsion)
        self._weight = np.concatenate([c.mass * self.hand.gravity, np.zeros(3)])

    def push(self, wrench: Array, until: float) -> None:
        """Push the object, in addition to the disturbances, until a simulated time, s.

        The wrench acts at the center of mass, palm axes, shape (6,), N and N m.
        """
        self._push, self._push_end = wrench, until

    def _expand(self, given: list[float]) -> Array:
        m, k = self.hand.joints, self.hand.fingers
        if len(given) == m:
            return np.array(given)
        if len(given) * k == m:
            return np.tile(given, k)
        raise ConfigurationError(
            f"initial_joints has {len(given)} angles; expected {m}, one per joint"
            + (f", or {m // k} for every finger" if m % k == 0 else "")
        )

    def reset(self) -> PlantState:
        """Return the initial state: at rest, with the fingers touching the object."""
        c = self.config.object
        self.time = 0.0
        self._steps = 0
        rotation = rotation_from_vector(c.rotation)
        start = self._initial_joints, np.array(c.position), rotation
        self._now = self._closed(at_rest(*start, self.hand.fingers, self._world.torsion))
        self.friction = np.full(self.hand.fingers, c.friction)
        self._torque = np.zeros(self.hand.joints)
        self.push(np.zeros(6), 0.0)
        self._user_turn = resting(np.eye(3))
        self._turn_palm(0.0)
        self.relaxed_steps = self.unsolved_steps = 0
        self._slides = np.zeros(self.hand.joints)  # directions in which joints slide, 0 at rest
        self._changes = sorted(self.config.friction_changes, key=lambda change: change.start)
        self._joint_sensor.reset()
        self._sense_joints()
        return self.state

    def _sense_joints(self) -> None:
        rates = self._now.velocities[: self.hand.joints]
        self._joints = self._joint_sensor.step(self._now.theta, rates, self._torque)

    def _closed(self, now: Motion) -> Motion:
        """Return the state in which tips near the object touch it exactly."""
        reach = _REACH if self.hand is self.model else _REACH_BY_TOUCH
        for _ in range(20):
            place = now.position, now.rotation, self.hand.tip_positions(now.theta)
            _, frames, gaps = contact_geometry(self._world, *place)
            if gaps.min() < -reach:
                finger = self.hand.finger_names[int(gaps.argmin())]
                raise ObjectModelError(
                    f"{finger} starts {-1e3 * gaps.min():.1f} mm inside the object; open the "
                    "hand (initial_joints), move the object or make it smaller"
                )
            missing = np.where(np.abs(gaps) <= reach, gaps, 0.0)
            if np.abs(missing).max() < 1e-15:
                break
            normals, jacobian = frames[:, :, 1], self.hand.fingertips(now.theta).linear
            moves = normals * missing[:, None]
            if self.hand.moves.sum(axis=1).min() < 3:  # a finger cannot move along the normal alone
                jacobian, moves = np.einsum("ki,kij->kj", normals, jacobian), missing
            rows = jacobian.reshape(-1, self.hand.joints)
            turn = np.linalg.lstsq(rows, moves.ravel(), rcond=1e-6)[0]
            now = now._replace(theta=now.theta + turn)
        return now

    def advance(self, torque: Array) -> PlantState:
        """Return the state one tick later, under constant torques, (m,), N m; see `drive`."""
        return self.drive(lambda since, theta, rates: torque)

    def drive(self, torque_of: Callable[[int, Array, Array], Array]) -> PlantState:
        """Return the state one tick later, with a torque for each integration step.

        The effort limits of the joints apply, and the joints report the mean torque. `torque_of`
        returns the torques, shape (m,), N m, from the time since the tick, ns, and the reported
        angles, rad, and rates, rad/s.

        Raises:
            DivergedError: If a velocity is impossibly large; then call `reset`.
        """
        limit, c = self.hand.effort_limits, self.config
        for i in range(c.steps_per_tick):
            torque = torque_of(i * c.step, self._joints.theta, self._joints.rates)
            self._acting = np.minimum(np.maximum(torque, -limit), limit)
            before = self._torque if i else self._acting
            self._torque = before + (self._acting - before) / (i + 1)
            self._step(c.time_step)
            self._sense_joints()
        if not self._now.velocities.dot(self._now.velocities) < _FASTEST**2:  # NaN is not, either
            raise DivergedError(
                f"the simulation has diverged at {self.time:.3f} s, joints or object are faster "
                f"than {_FASTEST:g} rad/s or m/s, as with late commands or high gains; "
                "lower the gains or the load of the computer, and reset the plant"
            )
        return self.state

    def _step(self, h: float) -> None:
        while self._changes and self._changes[0].start <= self.time:
            self.friction[:] = self._changes.pop(0).friction
        now, m, middle = self._now, self.hand.joints, self.time + 0.5 * h
        if self.config.palm_motion:
            self._user_turn = turned_by_user(self._user_turn, self.config.palm_turn, h)
        turning = self._turn_palm(middle)
        wrench, turns = self._weight, None
        if turning is not None and (turning.rate.any() or turning.acceleration.any()):
            theta, ahead = half_step(h, now)
            turns = self.hand.turning_torque(theta, ahead[:m], *turning[1:])
            place, rotation = moved(now.position, now.rotation, 0.5 * h, now.velocities[m:])
            body_motion = place, ahead[m : m + 3], ahead[m + 3 :]
            inertia = rotation @ self._world.inertia @ rotation.T
            wrench = wrench + apparent_wrench(turning, (self._world.mass, inertia), body_motion)
        if self.config.disturbances:
            wrench = external_wrench(self.config.disturbances, middle) + wrench
        if middle < self._push_end:
            wrench = self._push + wrench
        self._now = self._moved(h, turns, wrench)
        self.relaxed_steps += self._now.outcome == RELAXED
        self.unsolved_steps += self._now.outcome == UNSOLVED
        self._steps += 1
        self.time = self._steps * h

    def _moved(self, h: float, turns: Array | None, wrench: Array) -> Motion:
        """Return hand and object a step h, s, later; the part that another engine replaces.

        `turns` are the joint torques that balance a turning palm, shape (m,), N m; `wrench` is that
        of loads and weight about the object's center of mass, shape (6,), N and N m.
        """
        theta, ahead = half_step(h, self._now)
        terms = self.hand.dynamics(theta, ahead[: self.hand.joints])
        if turns is not None:
            terms = terms._replace(bias=terms.bias + turns)
        return self._with_losses(h, terms, wrench)

    def _with_losses(self, h: float, hand: Dynamics, wrench: Array) -> Motion:
        """Return a step with damping and Coulomb friction of the joints, where the hand has them.

        Damping is implicit, so that it is stable at any step. Friction is a torque against the
        velocity after the step, or less where it keeps a joint at rest. Which joints slide, and
        how, follows from trials that start with the last step, one joint changed after another.
        """
        if not self.hand.has_losses:
            return self._within_limits(h, self._now, hand, self._acting, wrench)
        m, start, largest = self.hand.joints, self._now.velocities, self.hand.friction
        inertia = hand.inertia + h * np.diag(self.hand.damping)
        bias = hand.bias + self.hand.damping * start[:m]
        hand = hand._replace(inertia=inertia, bias=bias)
        for _ in range(_TRIALS * m):
            rests = (self._slides == 0.0) & (largest > 0.0)
            torque = self._acting - self._slides * largest
            after = self._within_limits(h, *_at_rest(self._now, hand, rests), torque, wrench)
            pushes = np.tensordot(after.impulses, after.rows, 2)[:m] / h
            change = inertia @ (after.velocities - start)[:m] / h
            needed = np.where(rests, change - torque + bias - pushes, 0.0)
            excess = np.maximum(np.abs(needed) / np.where(rests, largest, 1.0) - 1.0, 0.0)
            turned = (self._slides * after.velocities[:m] < 0.0) & ~rests
            if not (turned.any() or excess.max() > _SLACK):
                break
            i = int(np.argmax(np.where(turned, np.inf, excess)))
            self._slides[i] = 0.0 if turned[i] else -np.sign(needed[i])
        return after

    def _within_limits(
        self, h: float, now: Motion, hand: Dynamics, torque: Array, wrench: Array
    ) -> Motion:
        """Return a step in which no joint passes a limit.

        At a limit is a stop, whose impulse acts on its joint alone and dissipates energy. If a
        joint would pass it, the step is repeated with that joint at rest, by a huge inertia. A
        later step may leave the stop.
        """
        lower, upper = self.hand.position_limits
        lowest, highest = np.minimum(lower, now.theta), np.maximum(upper, now.theta)
        stopped = np.zeros(self.hand.joints, dtype=np.bool_)
        while True:
            after = step(h, now, self._world, self.friction, hand, torque, wrench)
            passed = ((after.theta < lowest) | (after.theta > highest)) & ~stopped
            if not passed.any():
                return after
            stopped |= passed
            now, hand = _at_rest(now, hand, passed)

    def _turn_palm(self, time: float) -> Turning | None:
        """Turn gravity with the palm at a time, s; return its motion, None if it never turns."""
        if not self.config.palm_motion:
            return None
        turning = self._turning(time)
        gravity = turning.rotation.T @ self._gravity
        self.model.gravity = turning.rotation.T @ np.array(self.config.gravity)
        self.hand.gravity = gravity
        self._weight = np.concatenate([self._world.mass * gravity, np.zeros(3)])
        return turning

    def _turning(self, time: float) -> Turning:
        return turned_by(self._user_turn, palm_turning(self.config.palm_motion, time))

    @property
    def state(self) -> PlantState:
        """State of hand and object; a step replaces its arrays."""
        now, m = self._now, self.hand.joints
        tips = self.hand.tip_positions(now.theta)
        points, frames, gaps, impulses = observed(self._world, now, tips)
        forces, palm = impulses[:, :3] / self.config.time_step, None
        if self.config.palm_motion:
            palm = quaternion_from_rotation(self._turning(self.time).rotation)
        v = now.velocities
        hand = now.theta, v[:m], self._joints
        body = now.position, now.rotation, v[m : m + 3], v[m + 3 :]
        touch = TactileReading(points, quaternions_of_rows(frames.reshape(-1, 9)), forces)
        slip = now.sliding, now.slid, gaps
        speeds = np.hypot(now.sliding[:, 0], now.sliding[:, 1])
        return PlantState(
            *hand, *body, Contacts(points, frames), forces, *slip, touch, speeds, palm
        )

    @property
    def contact_residual(self) -> float:
        """Largest relative violation of the contact laws in the last step."""
        return self._now.residual

    @property
    def body_inertia(self) -> Array:
        """Inertia of the object, linear above angular, palm axes, shape (6, 6), kg and kg m^2."""
        out = self._world.mass * np.eye(6)
        out[3:, 3:] = self._now.rotation @ self._world.inertia @ self._now.rotation.T
        return out


def _at_rest(now: Motion, hand: Dynamics, joints: NDArray[np.bool_]) -> tuple[Motion, Dynamics]:
    """Stop some joints, shape (m,), by impulses on them, and hold them by a huge inertia."""
    if not joints.any():
        return now, hand
    m, inertia, v = len(joints), hand.inertia.copy(), now.velocities
    back = np.linalg.inv(inertia)[:, joints]
    impulse = np.linalg.solve(back[joints], v[:m][joints])
    now = now._replace(velocities=np.concatenate([v[:m] - back @ impulse, v[m:]]))
    inertia[joints, joints] += _ENDLESS * inertia.diagonal().max()
    return now, hand._replace(inertia=inertia)
