# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated hand and object, and the pushes on the object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import model_validator

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.command_guard import GuardConfig
from tactile_hand_ros.rotations import Vector
from tactile_hand_ros.simulation.joint_sensor import EncoderConfig
from tactile_hand_ros.simulation.palm_motion import PalmTurn
from tactile_hand_ros.simulation.skin import CalibrationConfig
from tactile_hand_ros.simulation.solid import MAX_VERTICES, Solid

_MAX_GYRATION = 10.0  # radius of gyration, relative to the reach of the object


class ObjectConfig(Config):
    """The object in the hand: shape, mass and initial pose."""

    shape: Literal["box", "cylinder", "sphere", "capsule"] = param(
        "box", "shape without vertices and mesh; the axis of a cylinder or capsule is z"
    )
    size: Vector = param((0.2604, 0.2604, 0.2604), "edges of the box around the shape", unit="m")
    vertices: list[float] = param(
        [], "corners x, y, z of a convex polyhedron", unit="m", max_length=3 * MAX_VERTICES
    )
    mesh: str = param("", "file with a closed surface, such as STL; its convex hull is touched")
    scale: float = param(1.0, "meters per unit of the mesh", gt=0.0)
    mass: float = param(0.0018, "mass", unit="kg", live=True, gt=0.0)
    inertia: list[float] = param(
        [], "inertia about its axes, empty for a uniform body", unit="kg m^2", max_length=3
    )
    friction: float = param(100.0, "Coulomb friction mu of fingertips on it", live=True, ge=0.0)
    position: Vector = param((0.0, 0.0, 0.4098), "initial center of mass, palm frame", unit="m")
    rotation: Vector = param((0.0, 0.0, 0.0), "initial rotation vector, palm frame", unit="rad")

    @model_validator(mode="after")
    def _is_a_body(self) -> ObjectConfig:
        if min(self.size) <= 0.0:
            raise ValueError(f"size = {self.size}: all three edges must be positive")
        self._check_shape()
        if len(self.vertices) % 3:
            raise ValueError(
                f"vertices has {len(self.vertices)} numbers; expected x, y, z of every corner"
            )
        if self.inertia:
            self._check_inertia()
        return self

    def _check_shape(self) -> None:
        """Reject two shapes, and a size that a round shape cannot have."""
        if (self.shape != "box") + bool(self.vertices) + bool(self.mesh) > 1:
            raise ValueError(
                f"shape = {self.shape}, {len(self.vertices) // 3} vertices and mesh = "
                f"'{self.mesh}': expected only one of a round shape, vertices and a mesh"
            )
        x, y, z = self.size
        expected, fits = {
            "cylinder": ("d, d, length", x == y),
            "sphere": ("d, d, d", x == y == z),
            "capsule": ("d, d, length with the caps", x == y <= z),
        }.get(self.shape, ("", True))
        if not fits:
            raise ValueError(f"size = {self.size}: a {self.shape} has [{expected}]")

    def _check_inertia(self) -> None:
        """Reject an inertia that is impossible, or far too large for this size and mass.

        The paper's object has four times the inertia that a body of its size can have.
        """
        if len(self.inertia) != 3 or min(self.inertia) <= 0.0:
            raise ValueError(
                f"inertia = {self.inertia}: expected three positive values, or none for those of a "
                "uniform body"
            )
        *others, largest = sorted(self.inertia)
        if largest > sum(others) * (1.0 + 1e-9):
            raise ValueError(
                f"inertia = {self.inertia}: no body has a principal inertia above the sum of the "
                f"other two; lower {largest:g} to {sum(others):g} or less, or raise the others"
            )
        if self.mesh:  # its reach is known only with the file
            return
        corners = np.reshape(self.vertices, (-1, 3)) if self.vertices else np.array([self.size]) / 2
        reach = float(np.linalg.norm(corners, axis=1).max())
        largest = _MAX_GYRATION**2 * self.mass * reach**2
        if max(self.inertia) > largest:
            raise ValueError(
                f"inertia = {self.inertia}: no body of {self.mass:g} kg that reaches {reach:.2g} m "
                f"from its center has more than {self.mass * reach**2:.2g} kg m^2; lower it"
            )

    def solid(self) -> Solid:
        """Return the shape, in the frame of the center of mass.

        Raises:
            ObjectModelError: If the vertices do not span a solid, or the mesh cannot be used.
        """
        if self.mesh:
            return Solid.of_mesh(self.mesh, self.scale)
        if self.vertices:
            return Solid(np.reshape(self.vertices, (-1, 3)))
        if self.shape != "box":
            return Solid.revolved(self.shape, self.size[0], self.size[2])
        return Solid.box(np.array(self.size))

    def inertia_about(self, solid: Solid) -> Array:
        """Return the inertia of a shape about the object's axes, shape (3, 3), kg m^2.

        Raises:
            ObjectModelError: If a uniform body has its center of mass elsewhere.
        """
        if self.inertia:
            return np.diag(self.inertia)
        return self.mass * solid.gyration()


class ContactConfig(Config):
    """Softness of the fingertips; without it contact is rigid, and a point."""

    compliance: float = param(
        0.0,
        "indentation of a soft tip per normal force; its shear is 1.5 times as soft",
        unit="m/N",
        ge=0.0,
    )
    torsion: float = param(
        0.0, "largest moment about the normal per largest friction force", unit="m", ge=0.0
    )


class Disturbance(Config):
    """One push on the object, at its center of mass and in palm axes."""

    kind: Literal["step", "ramp", "pulse", "sine"] = param(
        "step",
        "step stays, ramp rises for its duration and stays, pulse stops after its duration, sine "
        "oscillates for its duration",
    )
    start: float = param(0.0, "when it starts", unit="s", ge=0.0)
    duration: float = param(0.1, "how long a ramp, pulse or sine lasts", unit="s", gt=0.0)
    frequency: float = param(1.0, "frequency of a sine", unit="Hz", gt=0.0)
    force: Vector = param((0.0, 0.0, 0.0), "force, the amplitude of a sine", unit="N")
    torque: Vector = param((0.0, 0.0, 0.0), "torque, the amplitude of a sine", unit="N m")

    def factor(self, time: float) -> float:
        """Return the fraction of force and torque that acts at a time in s."""
        since = time - self.start
        if since < 0.0 or (self.kind in ("pulse", "sine") and since >= self.duration):
            return 0.0
        if self.kind == "ramp":
            return min(1.0, since / self.duration)
        return float(np.sin(2.0 * np.pi * self.frequency * since)) if self.kind == "sine" else 1.0


def external_wrench(disturbances: Sequence[Disturbance], time: float) -> Array:
    """Return w_e, force and torque about the object's center of mass, shape (6,), N and N m."""
    wrench = np.zeros(6)
    for push in disturbances:
        factor = push.factor(time)
        if factor != 0.0:
            wrench += factor * np.array((*push.force, *push.torque))
    return wrench


class FrictionChange(Config):
    """A change of the object's friction, as by water."""

    start: float = param(..., "when it changes", unit="s", ge=0.0)
    friction: float = param(..., "new Coulomb friction mu", ge=0.0)


class PlantConfig(Config):
    """Parameters of the plant."""

    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    initial_joints: list[float] = param(
        [1.047, 0.0, 1.571], "joint angles at the start, for all joints or one finger", unit="rad"
    )
    object: ObjectConfig = ObjectConfig()
    contact: ContactConfig = ContactConfig()
    gravity: Vector = param((0.0, 0.0, 0.0), "acceleration of gravity, palm frame", unit="m/s^2")
    calibration: CalibrationConfig = CalibrationConfig()
    encoder: EncoderConfig = EncoderConfig()
    effort_noise: float = param(0.0, "standard deviation of joint torques", unit="N m", ge=0.0)
    seed: int = param(1, "seed of everything random", ge=0)
    friction_changes: list[FrictionChange] = param([], "changes of the friction over time")
    disturbances: list[Disturbance] = param([], "external wrenches on the object over time")
    palm_motion: list[PalmTurn] = param(
        [], "orientations of the palm in the world over time; with any, `imu` is published"
    )
    palm_turn: Vector = param(
        (0.0, 0.0, 0.0),
        "rotation vector of the palm in the world by a user, after palm_motion; needs palm_motion",
        unit="rad",
        live=True,
    )
    engine: Literal["own", "mujoco"] = param("own", "physics engine; mujoco needs mujoco-core")
    time_step: float = param(0.001, "integration step", unit="s", ge=1e-5, le=0.01)
    rate: float = param(500.0, "ticks per second of simulated time", unit="Hz", gt=0.0, le=10000.0)
    pacing: Literal["lockstep", "realtime"] = param(
        "lockstep", "lockstep waits for each command, realtime follows the wall clock"
    )
    speed: float = param(
        0.0,
        "simulated seconds per second in lockstep, at most; 0 for as fast as possible",
        live=True,
        ge=0.0,
        le=100.0,
    )
    duration: float = param(0.0, "simulated time of the run, 0 for no end", unit="s", ge=0.0)
    autostart: bool = param(True, "run immediately; otherwise wait for the run service")
    command_timeout: float = param(
        1.0,
        "silence in lockstep after which the joints are held; in real time see guard.age_limit",
        unit="s",
        gt=0.0,
        le=60.0,
    )
    resend_after: float = param(
        0.1, "silence in lockstep after which a tick is sent again", unit="s", gt=0.0, le=10.0
    )
    guard: GuardConfig = GuardConfig()

    @property
    def steps_per_tick(self) -> int:
        """Number of integration steps in one tick."""
        return round(1.0 / (self.rate * self.time_step))

    @property
    def step(self) -> int:
        """Length of an integration step in ns."""
        return self.tick // self.steps_per_tick

    @property
    def tick(self) -> int:
        """Length of a tick in ns."""
        return round(1e9 / self.rate)

    @model_validator(mode="after")
    def _fits_together(self) -> PlantConfig:
        times = [turn.time for turn in self.palm_motion]
        if times != sorted(set(times)):
            raise ValueError(f"palm_motion has the times {times}, expected each after the last")
        if any(self.palm_turn) and not self.palm_motion:
            raise ValueError(
                f"palm_turn is {self.palm_turn}, but without palm_motion the hand has no imu and "
                "could not measure it; start with palm_motion=[{time: 0, rotation: [0, 0, 0]}]"
            )
        steps = 1.0 / (self.rate * self.time_step)
        if abs(steps - round(steps)) > 1e-9 or steps < 0.5:
            raise ValueError(
                f"rate = {self.rate} Hz with time_step = {self.time_step} s is {steps:.4g} steps "
                "a tick; expected a whole number: choose a time_step that divides 1/rate"
            )
        return self
