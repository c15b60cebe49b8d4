# SPDX-License-Identifier: Apache-2.0
"""The hand: kinematics and dynamics of any number of fingers, from a URDF by Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.config.hand_config import Coupling, FingerConfig, HandConfig, load_hand_config
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.tip_fit import fitted_tips
from tactile_hand_ros.hand.urdf import describe

SHORTEST_LEVER = 0.1  # of the longest; shorter ones amplify errors of torques tenfold


class Fingertips(NamedTuple):
    """Fingertip centers and their Jacobians at one configuration, all in palm axes.

    Attributes:
        positions: Centers p_f, shape (k, 3), m.
        linear: Jacobians J of the centers' velocities, shape (k, 3, m).
        angular: Jacobians J_Omega of the tips' angular velocities, shape (k, 3, m).

    Source: Shaw-Cortez et al., equation (1).
    """

    positions: Array
    linear: Array
    angular: Array


@compiled
def tip_jacobians(
    spatial: Array, support: NDArray[np.bool_], coupling: Array, centers: Array
) -> tuple[Array, Array]:
    """Return the Jacobians J and J_Omega of the fingertips, each of shape (k, 3, m), equation (1).

    Args:
        spatial: Velocities of the bodies at the palm's origin per rate of n single joints, linear
            above angular, palm axes, shape (6, n).
        support: Which single joints move which tip, shape (k, n).
        coupling: Rates of the single joints per rate of the driven ones, shape (n, m); empty where
            all are driven.
        centers: Fingertip centers, palm frame, shape (k, 3), m.
    """
    k, m = support.shape
    linear, angular = np.zeros((k, 3, m)), np.zeros((k, 3, m))
    for i in range(k):
        x, y, z = centers[i]
        for j in range(m):
            if support[i, j]:
                a, b, c = spatial[3, j], spatial[4, j], spatial[5, j]
                linear[i, 0, j] = spatial[0, j] + b * z - c * y
                linear[i, 1, j] = spatial[1, j] + c * x - a * z
                linear[i, 2, j] = spatial[2, j] + a * y - b * x
                angular[i, 0, j], angular[i, 1, j], angular[i, 2, j] = a, b, c
    if not coupling.size:
        return linear, angular
    shape = (k, 3, coupling.shape[1])
    driven = np.empty(shape), np.empty(shape)
    for i in range(k):
        driven[0][i], driven[1][i] = linear[i] @ coupling, angular[i] @ coupling
    return driven


@compiled
def tip_forces(tips: Fingertips, torque: Array) -> Array:
    """Return tip forces, shape (k, 3), N, that balance a joint torque tau, shape (m,), N m.

    The least-squares solution of J_i^T f_i = tau, without forces at levers below `SHORTEST_LEVER`.
    """
    k, axes, m = tips.linear.shape
    rows = tips.linear.reshape(k * axes, m)
    return least_squares(rows.T, torque).reshape(k, axes)


@compiled
def least_squares(a: Array, b: Array) -> Array:
    """Return the smallest x of the smallest |a x - b|; NaN unless b is finite."""
    if not np.isfinite(b).all():
        return np.full(a.shape[1], np.nan)
    return np.asarray(np.linalg.lstsq(a, b, SHORTEST_LEVER)[0], np.float64)


@compiled
def mirrored(upper: Array) -> Array:
    """Return the symmetric matrix of an upper triangle, shape (m, m)."""
    out = np.empty(upper.shape)
    for i in range(len(upper)):
        for j in range(i, len(upper)):
            out[i, j] = out[j, i] = upper[i, j]
    return out


class Dynamics(NamedTuple):
    """Fingertips, M_h, shape (m, m), and C_h theta' + N_h, shape (m,), N m, of equation (3)."""

    tips: Fingertips
    inertia: Array
    bias: Array


class Hand:
    """A hand with k fingers and m driven joints.

    A joint that follows another one, q_i = ratio q_j + offset, is no joint of its own: all angles
    are q = S theta + offset, so that J = J_q S and M_h = S^T M_q S. Postures theta and rates are
    those of the driven joints, shape (m,), rad and rad/s.

    Attributes:
        fingers: Number of fingers k.
        joints: Number of driven joints m.
        finger_names: Names of the k fingers.
        model: Pinocchio's model of all joints, also of those that follow; it must not be changed.
        tip_frames: Frames of the model at the centers of the fingertips, by finger.
        file: The URDF or MJCF.
        tip_links: Names of the fingers' last links.
        joint_names: Names of the m driven joints, in the order of every joint array.
        couplings: Those of the other joints, by their names.
        radii: Fingertip radii r, shape (k,), m.
        tip_errors: Errors of spheres fitted to meshes, shape (k,), m; 0 for given radii.
        description: URDF text of the hand in the chosen layout.
        effort_limits: Largest torque of each joint, shape (m,), N m; infinite where unset.
        velocity_limits: Largest speed of each joint, shape (m,), rad/s; infinite where unset.
        position_limits: Lowest and highest joint angles, two arrays of shape (m,), rad.
        damping: Torque per speed that the file states, shape (m,), N m s/rad.
        friction: Coulomb friction of the joints that the file states, shape (m,), N m.
        has_losses: Whether damping and friction act in the simulation; no controller knows them.
        bases: First joint of each finger, palm frame, shape (k, 3), m.
        spans: Largest distance of each fingertip from there, shape (k,), m.
        finger_mass: Mean mass of a finger, kg.
        finger_weight: Its weight on Earth, N.
        minimum_force: A hundredth of a finger's weight, N; below it a grasp does not count.
    """

    def __init__(
        self,
        config: HandConfig,
        layout: str = "",
        gravity: Array | None = None,
        link_lengths: float = 1.0,
        tip_radii: float = 1.0,
    ) -> None:
        """Build the hand in a layout, by default in its own one, and by default without gravity.

        Args:
            config: Names of the URDF, fingers and tips.
            layout: Name of the layout.
            gravity: Acceleration of gravity in the palm frame, shape (3,), m/s^2.
            link_lengths: Factor of the link lengths of the URDF.
            tip_radii: Factor of the fingertip radii of the YAML.

        Raises:
            HandModelError: If the URDF is missing or broken, or lacks a named link or joint.
        """
        self.description, self.couplings = describe(config, layout)
        self.model = _model(self.description, config)
        _stretch(self.model, link_lengths)
        fingers, self.tip_errors = fitted_tips(config, self.description)
        self.tip_frames = [_tip_frame(self.model, finger) for finger in fingers]
        self._data = self.model.createData()
        names = list(self.model.names[1:])
        driven = [name for name in names if name not in self.couplings]
        self._coupling, self._offsets = _coupling(names, driven, self.couplings)
        _check_inertia(self.model, self._coupling, driven, config.urdf)
        self._support = _support(self.model, self.tip_frames)
        # Views of the arrays that Pinocchio overwrites.
        self._spatial, self._inertia, self._bias = self._data.J, self._data.M, self._data.nle
        self._centers = [self._data.oMf[frame].translation for frame in self.tip_frames]
        self._turned: pin.Model | None = None  # with a palm that moves
        self._link_lengths = link_lengths
        self.gravity = np.zeros(3) if gravity is None else np.asarray(gravity)
        self.fingers = len(self.tip_frames)
        self.joints = len(driven)
        self.finger_names = config.finger_names
        self.file, self.tip_links = config.file, [finger.tip for finger in config.fingers]
        self.radii = tip_radii * np.array([finger.radius for finger in fingers])
        self.joint_names = driven
        self._set_limits()
        s = self._coupling if self._coupling.size else np.eye(self.joints)
        self.damping, self.friction = self.model.damping @ s**2, self.model.friction @ np.abs(s)
        self.has_losses = config.joint_losses == "file"
        self.bases, self.spans = _reaches(self.model, self.tip_frames)
        self.finger_mass = sum(body.mass for body in self.model.inertias[1:]) / self.fingers
        self.finger_weight = 9.81 * self.finger_mass
        self.minimum_force = 0.01 * self.finger_weight

    @classmethod
    def load(
        cls, name: str, layout: str = "", gravity: Array | None = None, **factors: float
    ) -> Hand:
        """Return a hand by name (``paper``) or YAML file; for the rest see the constructor."""
        return cls(load_hand_config(name), layout, gravity, **factors)

    def part(self, chosen: NDArray[np.bool_]) -> Hand:
        """Return the hand with the fingers of a mask, shape (k,), all joints and shared gravity."""
        if chosen.all():
            return self
        part, fingers = copy(self), np.flatnonzero(chosen)
        part.fingers = len(fingers)
        part.finger_names = [self.finger_names[i] for i in fingers]
        part.tip_frames = [self.tip_frames[i] for i in fingers]
        part._centers = [self._centers[i] for i in fingers]
        part._support, part.radii = self._support[chosen], self.radii[chosen]
        part.bases, part.spans = self.bases[chosen], self.spans[chosen]
        return part

    @property
    def moves(self) -> NDArray[np.bool_]:
        """Which driven joints move which fingertip, shape (k, m)."""
        s = self._coupling
        return self._support if not s.size else (self._support @ (s != 0.0)).astype(bool)

    def _set_limits(self) -> None:
        """Take the limits of the model; those of a joint that follows limit the one it follows."""
        model = self.model
        index = {name: i for i, name in enumerate(model.names[1:])}
        own = [index[name] for name in self.joint_names]
        efforts, speeds = model.effortLimit[own], model.velocityLimit
        speeds = np.where(speeds > 0.0, speeds, np.inf)
        lower, upper, fastest = (
            limit[own] for limit in (model.lowerPositionLimit, model.upperPositionLimit, speeds)
        )
        for name, c in self.couplings.items():
            i, j = index[name], self.joint_names.index(c.joint)
            ends = model.lowerPositionLimit[i], model.upperPositionLimit[i]
            low, high = sorted((end - c.offset) / c.ratio for end in ends)
            lower[j], upper[j] = max(lower[j], low), min(upper[j], high)
            fastest[j] = min(fastest[j], speeds[i] / abs(c.ratio))
        self.effort_limits = np.where(efforts > 0.0, efforts, np.inf)
        self.velocity_limits, self.position_limits = fastest, (lower, upper)

    def all_angles(self, theta: Array) -> Array:
        """Return the angles of all joints, shape (n,), rad, for those of the driven ones."""
        return self._coupling @ theta + self._offsets if self._coupling.size else theta

    def _all_rates(self, rates: Array) -> Array:
        return self._coupling @ rates if self._coupling.size else rates

    def _driven(self, torque: Array) -> Array:
        """Return the torques of the driven joints, shape (m,), N m, for those of all joints."""
        return self._coupling.T @ torque if self._coupling.size else torque

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity in the palm frame, shape (3,), m/s^2."""
        return np.array(self.model.gravity.linear)

    @gravity.setter
    def gravity(self, gravity: Array) -> None:
        self.model.gravity.linear = gravity

    def fingertips(self, theta: Array) -> Fingertips:
        """Return fingertip centers and Jacobians, equation (1)."""
        pin.computeJointJacobians(self.model, self._data, self.all_angles(theta))
        return self._tips_at(self._read_centers())

    def _tips_at(self, centers: Array) -> Fingertips:
        jacobians = tip_jacobians(self._spatial, self._support, self._coupling, centers)
        return Fingertips(centers, *jacobians)

    def tip_positions(self, theta: Array) -> Array:
        """Return the centers of the fingertips, palm frame, shape (k, 3), m."""
        pin.forwardKinematics(self.model, self._data, self.all_angles(theta))
        return self._read_centers()

    def _read_centers(self) -> Array:
        pin.updateFramePlacements(self.model, self._data)
        out = np.empty((len(self.tip_frames), 3))
        for i, center in enumerate(self._centers):
            out[i] = center
        return out

    def dynamics(self, theta: Array, rates: Array) -> Dynamics:
        """Return fingertips, inertia matrix M_h and bias C_h theta' + N_h of equation (3)."""
        model, data, s = self.model, self._data, self._coupling
        theta, rates = self.all_angles(theta), self._all_rates(rates)
        pin.computeJointJacobians(model, data, theta)
        pin.crba(model, data, theta)
        pin.nonLinearEffects(model, data, theta, rates)
        tips, inertia = self._tips_at(self._read_centers()), mirrored(self._inertia)
        if s.size:
            inertia = mirrored(s.T @ inertia @ s)
        return Dynamics(tips, inertia, np.array(self._driven(self._bias)))

    def turning_torque(self, theta: Array, rates: Array, spin: Array, acceleration: Array) -> Array:
        """Return the joint torques that balance the turning of the palm, shape (m,), N m.

        `spin` is its angular velocity, rad/s, and `acceleration` the derivative, palm axes, (3,).
        """
        if self._turned is None:
            self._turned = pin.buildModelFromXML(self.description, pin.JointModelFreeFlyer())
            _stretch(self._turned, self._link_lengths, palm=1)
            self._turned.gravity.linear = np.zeros(3)
            self._turned_data = self._turned.createData()
        rates = self._all_rates(rates)
        at = np.concatenate([np.zeros(6), [1.0], self.all_angles(theta)])
        turns, still = (np.concatenate([np.zeros(3), w, rates]) for w in (spin, np.zeros(3)))
        accelerations = np.concatenate([np.zeros(3), acceleration, np.zeros(len(rates))])
        model, data = self._turned, self._turned_data
        moved = np.array(pin.rnea(model, data, at, turns, accelerations))
        more = moved - pin.rnea(model, data, at, still, np.zeros(len(still)))
        return np.asarray(self._driven(more[6:]))

    def gravity_torque(self, theta: Array) -> Array:
        """Return the torques that hold the links against gravity, shape (m,), N m."""
        torque = pin.computeGeneralizedGravity(self.model, self._data, self.all_angles(theta))
        return np.array(self._driven(torque))

    def tip_rotations(self, theta: Array) -> Array:
        """Return the tips' frames with x along the link, palm frame, shape (k, 3, 3)."""
        pin.framesForwardKinematics(self.model, self._data, self.all_angles(theta))
        return np.array([self._data.oMf[frame].rotation for frame in self.tip_frames])

    def joint_positions(self, theta: Array) -> list[Array]:
        """Return joint and tip positions of every finger, palm frame, shape (joints + 1, 3), m."""
        data = self._data
        pin.framesForwardKinematics(self.model, data, self.all_angles(theta))
        chains = []
        for frame in self.tip_frames:
            places = [data.oMi[joint] for joint in _chain(self.model, frame)] + [data.oMf[frame]]
            chains.append(np.array([place.translation for place in places]))
        return chains


def _stretch(model: pin.Model, factor: float, palm: int = 0) -> None:
    """Scale all links behind the joint of the palm; the places of the fingers stay."""
    for joint in range(palm + 1, model.njoints):
        model.inertias[joint].lever = factor * model.inertias[joint].lever
        if model.parents[joint] > palm:
            placement = model.jointPlacements[joint]
            placement.translation = factor * placement.translation
    for frame in model.frames:
        if frame.parentJoint > palm:
            frame.placement.translation = factor * frame.placement.translation


def _chain(model: pin.Model, frame: int) -> list[int]:
    """Return the joints between the palm and a frame, in this order."""
    return list(model.supports[model.frames[frame].parentJoint])[1:]


def _support(model: pin.Model, tips: list[int]) -> NDArray[np.bool_]:
    """Return which joints move which tip frame, shape (k, n)."""
    out = np.zeros((len(tips), model.nv), dtype=bool)
    for i, frame in enumerate(tips):
        out[i, [model.idx_vs[joint] for joint in _chain(model, frame)]] = True
    return out


def _reaches(model: pin.Model, tips: list[int]) -> tuple[Array, Array]:
    """Return the fingers' first joints, shape (k, 3), and largest lengths, shape (k,), m.

    A finger is at most as long as the sum of its links and the travels of its sliding joints.
    """
    bases, spans = np.empty((len(tips), 3)), np.zeros(len(tips))
    travels = np.maximum(np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit))
    for i, frame in enumerate(tips):
        piece = model.frames[frame].placement
        for joint in reversed(_chain(model, frame)):
            spans[i] += np.linalg.norm(piece.translation)
            if model.joints[joint].shortname().startswith("JointModelP"):
                spans[i] += travels[model.idx_qs[joint]]
            piece = model.jointPlacements[joint]
        bases[i] = piece.translation
    return bases, spans


def _model(description: str, config: HandConfig) -> pin.Model:
    try:
        model = pin.buildModelFromXML(description)
    except (ValueError, RuntimeError) as error:
        raise HandModelError(f"'{config.urdf}' is not a usable URDF: {error}") from error
    if model.nq != model.nv or model.nv != model.njoints - 1:
        raise HandModelError(
            f"'{config.urdf}' has joints with more than one degree of freedom or without limits "
            "(continuous); use revolute or prismatic joints"
        )
    return model


def _coupling(
    names: list[str], driven: list[str], couplings: Mapping[str, Coupling]
) -> tuple[Array, Array]:
    """Return S, shape (n, m), and the offsets, shape (n,), of q = S theta + offset.

    S is empty where all joints are driven.
    """
    if not couplings:
        return np.zeros((0, 0)), np.zeros(0)
    s, offsets = np.zeros((len(names), len(driven))), np.zeros(len(names))
    for i, name in enumerate(names):
        c = couplings.get(name) or Coupling(joint=name)
        s[i, driven.index(c.joint)], offsets[i] = c.ratio, c.offset
    return s, offsets


def _check_inertia(model: pin.Model, coupling: Array, driven: list[str], urdf: str) -> None:
    """Reject a hand whose M_h of equation (3) has no inverse; name the joint that moves no mass."""
    posture = 0.3 + 0.1 * np.arange(model.nv)  # any, but not stretched
    inertia = mirrored(pin.crba(model, model.createData(), posture))
    if coupling.size:
        inertia = coupling.T @ inertia @ coupling
    values, directions = np.linalg.eigh(inertia)
    if not values[0] > 1e-12 * values[-1]:
        joint = driven[int(np.abs(directions[:, 0]).argmax())]
        raise HandModelError(
            f"joint '{joint}' of '{urdf}' moves no mass: the inertia matrix of the joints has the "
            f"eigenvalue {values[0]:.3g}, expected all above 0; give the links behind it an "
            "<inertial> with mass and inertia"
        )


def _tip_frame(model: pin.Model, finger: FingerConfig) -> int:
    """Return a frame at the center of a fingertip, with x along its axis."""
    if not model.existFrame(finger.tip, pin.BODY):
        links = [f.name for f in model.frames if f.type == pin.BODY]
        raise HandModelError(
            f"finger '{finger.name}' names tip link '{finger.tip}', which the URDF does not have "
            f"behind the palm; its links are: {', '.join(links)}"
        )
    found = int(model.getFrameId(finger.tip, pin.BODY))
    frame = model.frames[found]
    if frame.parentJoint == 0:
        raise HandModelError(
            f"tip link '{finger.tip}' of finger '{finger.name}' is not moved by any joint"
        )
    if finger.center == (0.0, 0.0, 0.0) and finger.axis == (1.0, 0.0, 0.0):
        return found
    x = np.array(finger.axis) / np.linalg.norm(finger.axis)
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), x).matrix()
    placement = frame.placement * pin.SE3(turn, np.array(finger.center))
    name = f"{finger.name} fingertip"
    tip = pin.Frame(name, frame.parentJoint, found, placement, pin.OP_FRAME)
    return int(model.addFrame(tip, False))
