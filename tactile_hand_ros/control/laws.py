# SPDX-License-Identifier: Apache-2.0
"""The laws: Kawamura's (8), contact points (10), the proposed (14), and `grip` without poses."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from pydantic import field_validator, model_validator

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, centroid, in_palm, joint_torques
from tactile_hand_ros.control.grasp import VirtualFrame, pose_error, wrench_forces
from tactile_hand_ros.control.loads import LoadObserver, ObserverConfig, limit_wrench
from tactile_hand_ros.errors import ConfigurationError, nearest
from tactile_hand_ros.hand.hand import Fingertips
from tactile_hand_ros.rotations import quaternion_from_rotation, rotation_from_quaternion

_OWN_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


class IntegralConfig(Config):
    """Integral action of Remark 1; a gain of zero switches it off."""

    time: float = param(
        0.0,
        "time in which it adds as much as a fitted gain, or as the spring of the law grip, 0 for "
        "none",
        unit="s",
        live=True,
        ge=0.0,
    )
    k_p: float = param(0.0, "gain on the position error", unit="N/(m s)", live=True, ge=0.0)
    k_o: float = param(0.0, "gain on the orientation error", unit="N m/(rad s)", live=True, ge=0.0)
    force_limit: float = param(5.0, "largest integral force", unit="N", live=True, ge=0.0)
    torque_limit: float = param(0.5, "largest integral torque", unit="N m", live=True, ge=0.0)


class LawConfig(Config):
    """Which law, and its gains (Table I)."""

    name: str = param(
        "optimal",
        "law: optimal is (14), contact is (10), kawamura is (8), grip holds a posture and presses "
        "by normal forces, or your own as module:Class",
    )
    folder: str = param("", "folder with the module of your own law; empty for PYTHONPATH")
    k_p: float = param(
        0.0, "position gain, 0 to fit the hand", unit="N/m", live=True, ge=0.0, le=1e4
    )
    k_o: float = param(
        0.0, "orientation gain, 0 to fit the hand", unit="N m/rad", live=True, ge=0.0, le=1e3
    )
    damping: float = param(
        0.0, "joint damping K_c, 0 to fit the hand", unit="N m s/rad", live=True, ge=0.0, le=1e2
    )
    k_st: float = param(0.0, "gain of the attitude term in (8)", unit="N m/rad", live=True, ge=0.0)
    r_ref: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), "reference of the attitude term in (8)", unit="rad", live=True
    )
    integral: IntegralConfig = IntegralConfig()
    observer: ObserverConfig = ObserverConfig()

    @field_validator("name")
    @classmethod
    def _is_a_law(cls, name: str) -> str:
        if name in LAWS or _OWN_NAME.fullmatch(name):
            return name
        hint = nearest(name, list(LAWS))
        expected = f"Expected one of {', '.join(LAWS)}, or module:Class"
        raise ValueError(f"'{name[:60]}' is not a law{hint} {expected}")

    @model_validator(mode="after")
    def _a_grip_controls_no_pose(self) -> LawConfig:
        given = self.integral.k_p, self.integral.k_o, self.observer.time
        if self.name == "grip" and max(self.k_p, self.k_o, self.damping, *given) > 0.0:
            raise ValueError(
                "the law 'grip' controls no pose and observes no load: set k_p, k_o, damping, "
                "integral.k_p, integral.k_o and observer.time to 0"
            )
        return self

    @property
    def uses_optimal_forces(self) -> bool:
        """Whether it presses by f*, so that three touching fingers are enough."""
        factory = LAWS.get(self.name) or OWN_LAWS.get((self.name, self.folder))
        return isinstance(factory, type) and issubclass(factory, OptimalLaw)


class AuxiliaryPose(NamedTuple):
    """Estimated pose of the object: contact centroid, m, and virtual frame, in the palm frame."""

    position: Array
    orientation: Array


class Target(NamedTuple):
    """Desired pose of the grasp, p_d, m, and R_pod in the palm frame; NaN keeps the present value.

    `sent` is the quaternion of R_pod in the message (x, y, z, w), shape (4,); None without one.
    """

    position: Array
    orientation: Array
    sent: Array | None = None

    @classmethod
    def of(cls, position: Array, quaternion: Array) -> Target:
        """Return the target of a message: p_d, shape (3,), m, and R_pod (x, y, z, w)."""
        return cls(position, rotation_from_quaternion(quaternion), quaternion)

    @property
    def quaternion(self) -> Array:
        """Quaternion of R_pod (x, y, z, w), exactly as sent, shape (4,)."""
        return quaternion_from_rotation(self.orientation) if self.sent is None else self.sent

    def kept(self, pose: AuxiliaryPose) -> Target:
        """Return it with the missing part taken from a pose of the grasp."""
        kept = self
        if np.isnan(self.position).any():
            kept = kept._replace(position=pose.position)
        if np.isnan(self.orientation).any():
            kept = Target.of(kept.position, quaternion_from_rotation(pose.orientation))
        return kept


class LawTorque(NamedTuple):
    """Joint torques of a law by purpose, each of shape (m,), N m.

    Attributes:
        internal: Internal force; does no work on a rigid grasp.
        load_compensation: Carries the load on the object: integral action and observer.
        drive: Moves the object towards its target.
        damping: -K_c theta'.
    """

    internal: Array
    load_compensation: Array
    drive: Array
    damping: Array

    @property
    def total(self) -> Array:
        """The torque of the law, shape (m,), N m."""
        return self.internal + self.load_compensation + self.drive + self.damping

    def within(self, limits: Array, weight: Array) -> Array:
        """Return the torque with that of the links' weight within effort limits, (m,), N m.

        Internal force and load come first and keep their direction, then the drive. Damping takes
        the rest, joint by joint. All have the shape (m,), N m.
        """
        carried = self.load_compensation + weight
        torque = bearable_fraction(self.internal, carried, limits) * self.internal + carried
        torque = torque + bearable_fraction(self.drive, torque, limits) * self.drive + self.damping
        return np.asarray(np.minimum(np.maximum(torque, -limits), limits))


@compiled
def bearable_fraction(part: Array, rest: Array, limits: Array) -> float:
    """Return the largest s for which |s part + rest| stays within the effort limits.

    If a single joint stayed at its limit, the internal force would no longer balance and would push
    the object away. The same fraction, 0 to 1, in all joints keeps the balance. The torque of a
    part, such as the internal force, all other torque and the limits have the shape (m,), N m.
    """
    fraction = 1.0
    for i in range(len(limits)):
        if abs(part[i] + rest[i]) > limits[i] and part[i] != 0.0:
            room = limits[i] - np.sign(part[i]) * rest[i]
            fraction = min(fraction, room / abs(part[i]))
    return max(fraction, 0.0)


_CARRIES = 0.25  # of k_f, a load that it bears with its reserve
_NO_LOAD = 1e-3  # N, keeps the inertia of an object regular
_OF_ERRORS = np.repeat([1.0, 0.5], 3)  # |r_d| is twice the angle


class FittedGains(NamedTuple):
    """Gains that fit a hand and its grasp; see `holds.fitted_gains`.

    Attributes:
        rest: K_c of rates that do not move the object, shape (m, m), N m s/rad.
        momenta: B of n motions that do, with K_c = B diag(w) B^T, shape (m, n).
        wrenches: G of these motions, with the damping D = G diag(w) G^T of twists, shape (6, n).
        quietest: w up to which angle errors may shake the hand at any k_f, shape (n,), rad/s.
        needed: w that k_f needs, rad/s per N.
        largest: w up to which held and late torques damp, rad/s.
        lag: L of K_p = D (L D + F diag B)^-1 D with a load F, so D / L for light objects, s.
        body: B, (6,): inertia of an object of 1 N over the phase that it may cost, s^2/m and m s^2.
        observes: Smallest time constant of the load observer, s.
    """

    rest: Array
    momenta: Array
    wrenches: Array
    quietest: Array
    needed: float
    largest: float
    lag: float
    body: Array
    observes: float

    def at(self, grasp_force: float, load: float) -> tuple[Array, Array]:
        """Return K_c, (m, m), N m s/rad, and K_p, (6, 6), of a k_f and the force of a load, N.

        An object on a support shows no load, so the load counts at least as a quarter of k_f, which
        a grasp bears with its reserve. K_p couples position and orientation, as the damping does.
        Otherwise rotations about a point beside the contacts would be too stiff.
        """
        return _gains_at(self, grasp_force, load)


@compiled
def _gains_at(gains: FittedGains, grasp_force: float, load: float) -> tuple[Array, Array]:
    w = np.minimum(np.maximum(gains.quietest, gains.needed * grasp_force), gains.largest)
    damping = (gains.wrenches * w) @ gains.wrenches.T
    force = max(load, _CARRIES * grasp_force, _NO_LOAD)
    late = gains.lag * damping + np.diag(force * gains.body)
    stiffness = damping @ np.linalg.solve(late, damping) * _OF_ERRORS
    return gains.rest + (gains.momenta * w) @ gains.momenta.T, stiffness


class LawInput(NamedTuple):
    """Input of a law at one tick: f* is in contact frames, shape (k, 3), and k_f in N."""

    tips: Fingertips
    contacts: Contacts
    optimal_forces: Array
    grasp_force: float


class Law(Protocol):
    """Interface of a law; it is built once for a configuration.

    A law of your own may derive from one of this module, such as (14) with twice the internal
    force:

    >>> class Firm(OptimalLaw):
    ...     def internal_torque(self):
    ...         return 2.0 * super().internal_torque()
    >>> from tactile_hand_ros import simulate
    >>> simulate("paper", {"duration": 0.1, "targets": []}, law=Firm).metrics.ticks
    51

    Attributes:
        seen: Input at this tick, set by `ManipulationLaw`.
    """

    seen: LawInput

    def internal_torque(self) -> Array:
        """Return the torques of the internal force, shape (m,), N m."""

    def drive(self, wrench: Array) -> Array:
        """Return the torques, (m,), N m, that apply a wrench, (6,), about the contact centroid."""


LawFactory = Callable[[LawConfig, Array], Law]
"""Makes a law from its gains and the radii of the fingertips, such as a class of laws."""


class ManipulationLaw:
    """Virtual frame, integral action and load observer around one of the laws.

    Attributes:
        acts: Whether its torques reach the joints; otherwise the integral waits.
        fits: Whether all gains are given, so that none must be fitted to the hand.
        integral: Wrench of the integral action, shape (6,), N and N m.
    """

    def __init__(self, config: LawConfig, radii: Array) -> None:
        """Build the law of a configuration for fingertips with radii of shape (k,), m."""
        self._radii, self._centroid = np.asarray(radii), np.zeros(3)
        self.acts = True
        self._fitted: FittedGains | None = None
        self.reset()
        self.configure(config)

    def configure(self, config: LawConfig) -> None:
        """Change the gains; integral and observed load stay unless they are switched off."""
        self.config = config
        self._law = law_of(config)(config, self._radii)
        self._gains = np.repeat([config.k_p, config.k_o], 3)
        self._is_given = self._gains > 0.0
        self.fits = bool(self._is_given.all()) and config.damping > 0.0
        c = config.integral
        self._integrates = max(c.k_p, c.k_o, c.time) > 0.0
        gains, fitted = np.repeat([c.k_p, c.k_o], 3), 1.0 / c.time if c.time > 0.0 else 0.0
        self._integral_gains = gains, fitted, gains + fitted > 0.0
        if not self._integrates:
            self.integral[:] = 0.0
        if config.observer.time == 0.0:
            self._observer = LoadObserver()

    def fit(self, gains: FittedGains) -> None:
        """Use fitted gains where none are given."""
        self._fitted = gains

    def reset(self) -> None:
        """Forget the grasp and the integral."""
        self._frame, self._observer = VirtualFrame(), LoadObserver()
        self.integral: Array = np.zeros(6)
        self._pose: AuxiliaryPose | None = None  # of the last tick
        self._offset: tuple[Array, Array] | None = None  # of the pose in the contacts' frame
        self._changed = False

    def change_fingers(self) -> None:
        """Use other fingers from the next tick on; pose and load do not jump."""
        self._changed = True

    def auxiliary_pose(self, tips: Fingertips, contacts: Contacts) -> AuxiliaryPose:
        """Return the estimated pose of the object, palm frame.

        Laws (10) and (14) follow the contact points, law (8) the fingertip centers.

        Raises:
            GraspError: If the points do not define a frame (A7).
        """
        points = tips.positions if self.config.name == "kawamura" else contacts.positions
        if self._changed:
            self._frame = VirtualFrame()
        position, frame = centroid(points), self._frame.orientation(points)
        if self._changed and self._pose is not None:
            before = self._pose
            self._offset = frame.T @ (before.position - position), frame.T @ before.orientation
            for wrench in (self.integral, self._observer.wrench):  # about the new centroid
                wrench[3:] += np.cross(self._centroid - position, wrench[:3])
        self._changed = False
        pose = AuxiliaryPose(position, frame)
        if self._offset is not None:
            pose = AuxiliaryPose(position + frame @ self._offset[0], frame @ self._offset[1])
        self._pose, self._centroid = pose, position
        return pose

    def step(
        self,
        seen: LawInput,
        rates: Array,
        target: Target,
        auxiliary: AuxiliaryPose,
        dt: float,
        forces: Array | None = None,
    ) -> LawTorque:
        """Return the joint torques of the law, without gravity compensation.

        Args:
            seen: Input of the law; only (14) uses f*.
            rates: Joint rates, shape (m,), rad/s.
            target: Desired pose.
            auxiliary: Pose from `auxiliary_pose` at this tick.
            dt: Time since the last step, s; drives integral action and observer.
            forces: Measured forces in contact frames, shape (k, 3), N; used by the observer.

        Raises:
            CollinearContactsError: If the contacts lie on a line (A7).
        """
        c = self.config
        error = pose_error(*auxiliary, target.position, target.orientation)
        wrench, damping, pull = self._gains * error, c.damping * rates, np.zeros(6)
        if self._fitted is not None and not self.fits:
            force = self.integral[:3] + self._observer.wrench[:3]  # of the last tick
            fitted, stiffness = self._fitted.at(seen.grasp_force, math.sqrt(force.dot(force)))
            pull = stiffness @ error
            wrench = np.where(self._is_given, wrench, pull)
            damping = damping if c.damping > 0.0 else fitted @ rates
        self._integrate(error, pull, dt)
        law = self._law
        law.seen = seen
        carried = self._carried(seen.contacts, forces, dt)
        load = np.zeros(len(rates)) if carried is None else law.drive(carried)
        return LawTorque(law.internal_torque(), load, law.drive(wrench), -damping)

    def _carried(self, contacts: Contacts, forces: Array | None, dt: float) -> Array | None:
        """Return the wrench of integral and observer, shape (6,), or None while both are off."""
        c = self.config
        if c.observer.time > 0.0 and forces is not None:
            # What a guard carries is to be carried from the first tick that acts again.
            passed = dt if self.acts else np.inf
            slower = self._fitted.observes if self._fitted else 0.0
            return self.integral + self._observer.step(c.observer, contacts, forces, passed, slower)
        return self.integral if self._integrates else None

    def _integrate(self, error: Array, pull: Array, dt: float) -> None:
        """Integrate the error; force and torque are each held inside their limit (anti-windup).

        `pull` is the wrench of fitted gains for it. A part without a gain is zero.
        """
        if not (self._integrates and self.acts):
            return
        c, (gains, fitted, integrated) = self.config.integral, self._integral_gains
        added = gains * dt * error + fitted * dt * pull
        self.integral = np.where(integrated, self.integral + added, 0.0)
        limit_wrench(self.integral, c.force_limit, c.torque_limit)


class KawamuraLaw:
    """Equation (8): press towards the centroid of the tips, and turn the object with the tips."""

    seen: LawInput

    def __init__(self, config: LawConfig, radii: Array) -> None:
        """Build the law for fingertips with radii of shape (k,), m."""
        self._reach = radii.sum()
        self._attitude = config.k_st * np.array(config.r_ref)

    def internal_torque(self) -> Array:
        """Return the internal torques, with the relative attitude term, shape (m,), N m."""
        tips = self.seen.tips
        middle = tips.positions.sum(axis=0) / len(tips.positions)
        pull = self.seen.grasp_force / self._reach * (middle - tips.positions)
        attitude = np.einsum("kim,i->m", tips.angular, self._attitude)
        return np.asarray(np.einsum("kim,ki->m", tips.linear, pull) + attitude)

    def drive(self, wrench: Array) -> Array:
        """Return the torques for a full wrench at each finger; see `Law.drive`."""
        tips = self.seen.tips
        moving = np.einsum("kim,i->m", tips.linear, wrench[:3])
        return np.asarray(moving + np.einsum("kim,i->m", tips.angular, wrench[3:]))


class ContactLaw:
    """Equation (10): press towards the contacts' centroid, manipulate through the grasp map."""

    seen: LawInput

    def __init__(self, config: LawConfig, radii: Array) -> None:
        """Build the law; it has no parameters."""

    def internal_forces(self) -> Array:
        """Return the internal forces in palm axes, shape (k, 3), N."""
        contacts = self.seen.contacts
        return self.seen.grasp_force * (contacts.centroid - contacts.positions)

    def internal_torque(self) -> Array:
        """Return the torques of the internal force, shape (m,), N m."""
        return self._pressing(self.internal_forces())

    def drive(self, wrench: Array) -> Array:
        """Return the torques of the smallest forces with a wrench; see `Law.drive`."""
        return self._pressing(wrench_forces(self.seen.contacts.positions, wrench))

    def _pressing(self, forces: Array) -> Array:
        return joint_torques(self.seen.tips, self.seen.contacts.positions, forces)


class OptimalLaw(ContactLaw):
    """Equation (14): as (10), but press by the optimal forces of (13)."""

    def internal_forces(self) -> Array:
        """Return the internal forces in palm axes, shape (k, 3), N."""
        seen = self.seen
        return in_palm(seen.contacts.rotations, seen.optimal_forces, seen.grasp_force)


_GRIP_PHASE = 0.25  # rad that the age of touch costs the control of normal forces


_PRESSING = 0.01  # of k_f; a finger with less shows only noise


class NormalForceControl:
    """Integral action on the normal forces, for the law `grip`.

    Friction in the fingers and errors of the drives keep a part of k_f f* from the object. The law
    presses with (k_f + c) f*, the internal torques of (14), where

        c' = g max_i (k_f f*_n,i - n_i) / f*_n,i .

    The normal forces n of an object at rest balance with its load, so only the common factor of
    their internal part can be chosen. This is the one at which no finger presses with less than its
    part of k_f.

    Where springs of stiffness k_j keep the posture, contacts of stiffness k_c receive the fraction
    k_c / (k_c + k_j) of a change of c. It is at most 1 for any object of one stiffness, and below
    1.5 with contacts of 100 N/m and 1 MN/m on one hand. With an age d of forces and torques,
    g = 0.25 / d is a sixth of the gain at which a loop with the fraction 1 oscillates.

    Attributes:
        correction: c, N.
    """

    def __init__(self) -> None:
        """Start without a correction."""
        self.correction = 0.0

    def step(
        self,
        grasp_force: float,
        fractions: Array,
        normal: Array,
        minimum: float,
        maximum: float,
        dt: float,
        age: float,
    ) -> float:
        """Return k_f + c, N, for k_f, N, fractions f*_n, (k,), and measured normal forces, (k,), N.

        c has a minimum and a maximum, N, since a dead skin never shows the wanted force. `dt` is
        the time since the last step, s, and `age` is d, s.
        """
        pressing = fractions > _PRESSING
        missing = (grasp_force - normal[pressing] / fractions[pressing]).max(initial=-math.inf)
        if math.isfinite(missing):
            raised = self.correction + _GRIP_PHASE / age * dt * float(missing)
            self.correction = min(max(raised, minimum), maximum)
        return grasp_force + self.correction


LAWS: dict[str, LawFactory] = {
    "optimal": OptimalLaw,
    "contact": ContactLaw,
    "kawamura": KawamuraLaw,
    "grip": OptimalLaw,  # with the posture and the correction of the controller
}

OWN_LAWS: dict[tuple[str, str], LawFactory] = {}
"""Laws of users by name and folder, imported by `own_law.take_law`."""


def law_of(config: LawConfig) -> LawFactory:
    """Return the law that a configuration names.

    Raises:
        ConfigurationError: If it is a law of a user that was not imported.
    """
    factory = LAWS.get(config.name) or OWN_LAWS.get((config.name, config.folder))
    if factory is None:
        raise ConfigurationError(
            f"the law '{config.name}' is code outside this package, which no recording can import; "
            f"to use it, name it yourself: --law {config.name}"
        )
    return factory
