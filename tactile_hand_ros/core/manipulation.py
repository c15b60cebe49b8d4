# SPDX-License-Identifier: Apache-2.0
"""The manipulation laws: Kawamura's (8), the contact-point law (10) and the proposed law (14)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.contact import Contacts, hand_jacobian
from tactile_hand_ros.core.grasp import wrench_forces
from tactile_hand_ros.core.hand import Fingertips
from tactile_hand_ros.core.virtual_frame import VirtualFrame, orientation_error

Array = NDArray[np.float64]


class IntegralConfig(Config):
    """Integral action of Remark 1; a gain of zero switches it off."""

    k_p: float = param(0.0, "gain on the position error", unit="N/(m s)", live=True, ge=0.0)
    k_o: float = param(0.0, "gain on the orientation error", unit="N m/(rad s)", live=True, ge=0.0)
    force_limit: float = param(5.0, "largest integral force", unit="N", live=True, ge=0.0)
    torque_limit: float = param(0.5, "largest integral torque", unit="N m", live=True, ge=0.0)


class LawConfig(Config):
    """Which law, and its gains (Table I)."""

    name: Literal["optimal", "contact", "kawamura"] = param(
        "optimal", "law: optimal is (14), contact is (10), kawamura is (8)"
    )
    k_p: float = param(3.0, "position gain", unit="N/m", live=True, ge=0.0, le=1e4)
    k_o: float = param(0.5, "orientation gain", unit="N m/rad", live=True, ge=0.0, le=1e3)
    damping: float = param(0.07, "joint damping K_c", unit="N m s/rad", live=True, ge=0.0, le=1e2)
    k_st: float = param(
        0.0, "gain of the relative attitude term in (8)", unit="N m/rad", live=True, ge=0.0
    )
    r_ref: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), "reference of the relative attitude term in (8)", unit="rad", live=True
    )
    integral: IntegralConfig = IntegralConfig()


@dataclass(frozen=True)
class Target:
    """Where the hand shall bring the grasp: p_d and R_pod in the palm frame."""

    position: Array
    orientation: Array


@dataclass(frozen=True)
class AuxiliaryPose:
    """What the hand believes of the object: a centroid and the virtual frame, palm frame."""

    position: Array
    orientation: Array


@dataclass(frozen=True)
class LawTorque:
    """Joint torques of a law by what they are for, each of shape (m,), N m.

    Attributes:
        squeeze: Holds the object; does no work on a rigid grasp.
        drive: Moves the object towards its target.
        damping: -K_c theta'.
    """

    squeeze: Array
    drive: Array
    damping: Array

    @property
    def total(self) -> Array:
        """The torque of the law, shape (m,), N m."""
        return self.squeeze + self.drive + self.damping


@dataclass(frozen=True)
class LawInput:
    """What a law sees at one tick: joints and touch, nothing of the object.

    Attributes:
        tips: Fingertip centres and Jacobians.
        radii: Fingertip radii, shape (k,), m.
        contacts: Contact points and frames.
        optimal_forces: f* in contact frames, shape (k, 3).
        grasp_force: k_f, N.
        wrench: Manipulation wrench K_p [p_d - p; r_d] plus integral action, shape (6,).
    """

    tips: Fingertips
    radii: Array
    contacts: Contacts
    optimal_forces: Array
    grasp_force: float
    wrench: Array


class ManipulationLaw:
    """Integral action and virtual frame around one of the three laws."""

    def __init__(self, config: LawConfig, radii: Array) -> None:
        """Build a law for fingertips of the given radii, shape (k,), m."""
        self.config = config
        self._radii = np.asarray(radii)
        self._frame = VirtualFrame()
        self._integral = np.zeros(6)

    def configure(self, config: LawConfig) -> None:
        """Take other gains; the state of the integral stays."""
        self.config = config

    def reset(self) -> None:
        """Forget the grasp and the integral."""
        self._frame.reset()
        self._integral[:] = 0.0

    @property
    def integral_wrench(self) -> Array:
        """Wrench of the integral action, shape (6,), N and N m."""
        return self._integral.copy()

    def auxiliary_pose(self, tips: Fingertips, contacts: Contacts) -> AuxiliaryPose:
        """Return what the hand believes of the object's pose.

        Laws (10) and (14) follow the contact points, law (8) the fingertip centres.

        Raises:
            GraspError: If the points do not define a frame (A7).
        """
        points = tips.positions if self.config.name == "kawamura" else contacts.positions
        return AuxiliaryPose(points.sum(axis=0) / len(points), self._frame.orientation(points))

    def step(
        self,
        tips: Fingertips,
        rates: Array,
        contacts: Contacts,
        optimal_forces: Array,
        grasp_force: float,
        target: Target,
        auxiliary: AuxiliaryPose,
        dt: float,
    ) -> LawTorque:
        """Return the joint torques of the law, without gravity compensation.

        Args:
            tips: Fingertip centres and Jacobians.
            rates: Joint rates, shape (m,), rad/s.
            contacts: Contact points and frames.
            optimal_forces: f* in contact frames, shape (k, 3); used by (14) only.
            grasp_force: k_f, N.
            target: Desired pose.
            auxiliary: Pose from `auxiliary_pose` at this tick.
            dt: Time since the last step, s; drives the integral action.

        Raises:
            CollinearContactsError: If the contacts lie on a line (A7).
        """
        error = np.concatenate(
            [
                target.position - auxiliary.position,
                orientation_error(auxiliary.orientation, target.orientation),
            ]
        )
        self._integrate(error, dt)
        c = self.config
        wrench = self._integral.copy()
        wrench[:3] += c.k_p * error[:3]
        wrench[3:] += c.k_o * error[3:]
        seen = LawInput(tips, self._radii, contacts, optimal_forces, grasp_force, wrench)
        squeeze, drive = LAWS[c.name](seen, c)
        return LawTorque(squeeze, drive, -c.damping * rates)

    def _integrate(self, error: Array, dt: float) -> None:
        """Integrate the error; force and torque are each held inside their limit (anti-windup)."""
        c = self.config.integral
        for gain, limit, part in (
            (c.k_p, c.force_limit, slice(0, 3)),
            (c.k_o, c.torque_limit, slice(3, 6)),
        ):
            if gain == 0.0:
                self._integral[part] = 0.0
                continue
            self._integral[part] += gain * dt * error[part]
            size = float(np.linalg.norm(self._integral[part]))
            if size > limit:
                self._integral[part] *= limit / size


def kawamura_law(seen: LawInput, config: LawConfig) -> tuple[Array, Array]:
    """Equation (8): squeeze towards the tips' centroid, turn the object by turning the tips."""
    tips = seen.tips
    centroid = tips.positions.sum(axis=0) / len(tips.positions)
    pull = seen.grasp_force / seen.radii.sum() * (centroid - tips.positions)
    turn = config.k_st * np.array(config.r_ref) + seen.wrench[3:]
    drive = np.einsum("kim,i->m", tips.linear, seen.wrench[:3])
    return (
        np.einsum("kim,ki->m", tips.linear, pull),
        drive + np.einsum("kim,i->m", tips.angular, turn),
    )


def contact_law(seen: LawInput, config: LawConfig) -> tuple[Array, Array]:
    """Equation (10): squeeze towards the contacts' centroid, manipulate through the grasp map."""
    squeeze = seen.grasp_force * (seen.contacts.centroid - seen.contacts.positions)
    return _joint_torques(seen, squeeze)


def optimal_law(seen: LawInput, config: LawConfig) -> tuple[Array, Array]:
    """Equation (14): squeeze by the optimal forces, manipulate through the grasp map."""
    in_palm = (seen.contacts.rotations @ seen.optimal_forces[:, :, None])[:, :, 0]
    return _joint_torques(seen, seen.grasp_force * in_palm)


def _joint_torques(seen: LawInput, squeeze: Array) -> tuple[Array, Array]:
    """Map squeezing forces, shape (k, 3), and the manipulation wrench to joint torques."""
    points = seen.contacts.positions
    jacobian = hand_jacobian(seen.tips, points)
    transposed = jacobian.reshape(-1, jacobian.shape[-1]).T
    return transposed @ squeeze.ravel(), transposed @ wrench_forces(points, seen.wrench).ravel()


LAWS = {"optimal": optimal_law, "contact": contact_law, "kawamura": kawamura_law}
