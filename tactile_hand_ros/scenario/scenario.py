# SPDX-License-Identifier: Apache-2.0
"""Scenarios: one typed YAML file that describes a run completely."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from pydantic import ValidationError, field_serializer, field_validator, model_validator

from tactile_hand_ros.config.model import Config, param, validate
from tactile_hand_ros.config.plain_yaml import find_file, yaml_text
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.control.slip.regulator import SlipRegulatorConfig
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.own_law import take_law
from tactile_hand_ros.rotations import Vector, rotation_from_vector
from tactile_hand_ros.scenario.files import CONTROLLER, merged, put_changes, read_layers
from tactile_hand_ros.simulation.joint_sensor import EncoderConfig
from tactile_hand_ros.simulation.plant_config import PlantConfig
from tactile_hand_ros.simulation.skin import CalibrationConfig, TactileSensorConfig

# Set once for the whole scenario and passed to every node that has such a parameter.
_SHARED = ("hand", "layout", "gravity", "calibration", "seed", "duration")
NODES = ("plant", "tactile_sensor", "slip_regulator", "force_optimizer", "manipulation_controller")


class _Event(Config):
    time: float = param(0.0, "simulated time of the command", unit="s", ge=0.0)

    @property
    def stamp(self) -> int:
        """The tick of the command, ns."""
        return round(self.time * 1e9)


class TargetConfig(_Event):
    """A desired pose and when it is commanded."""

    position: Vector | None = param(
        ..., "p_d of the contact centroid, palm frame; keep for that of the grasp then", unit="m"
    )
    rotation: Vector | None = param(
        "keep", "R_pod as a rotation vector, palm frame; without, that of the grasp", unit="rad"
    )

    @field_validator("position", "rotation", mode="before")
    @classmethod
    def _may_be_kept(cls, value: Any) -> Any:
        if value is None or (isinstance(value, str) and value != "keep"):
            raise ValueError(f"'{str(value)[:60]}' is neither [x, y, z] nor keep")
        return None if value == "keep" else value

    @field_serializer("position", "rotation")
    def _kept(self, value: Vector | None) -> Vector | str:
        return "keep" if value is None else value

    def target(self) -> Target:
        """Return position and orientation as arrays, NaN for kept ones."""
        position = np.full(3, np.nan) if self.position is None else np.array(self.position)
        if self.rotation is None:
            return Target.of(position, np.full(4, np.nan))
        return Target(position, rotation_from_vector(self.rotation))


class UserForceConfig(_Event):
    """A grasp force requested by the user, and its time.

    `ClosedLoop` applies it at that very tick. Over ROS, the orchestrator sends it when the time has
    come, like a user, so it arrives a varying number of ticks later.
    """

    force: float = param(..., "k_f", unit="N", gt=0.0)


UNLIMITED_SLIP = 1.0
"""Unlimited slip distance: farther than any contact slides in a hand [m]."""


class GoalConfig(Config):
    """Limits within which the last target counts as reached."""

    position_error: float = param(0.001, "largest final position error", unit="m", gt=0.0)
    rotation_error: float = param(0.01, "largest final rotation error |r_d|", unit="rad", gt=0.0)
    slip_distance: float = param(
        UNLIMITED_SLIP, "largest total slip distance of a contact", unit="m", gt=0.0
    )


class Scenario(Config):
    """One experiment: hand, object, gains, sensors, targets over time."""

    name: str = param("", "name, by default that of the file")
    description: str = param("", "what happens and why, in a sentence")
    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    gravity: Vector = param((0.0, 0.0, 0.0), "acceleration of gravity, palm frame", unit="m/s^2")
    calibration: CalibrationConfig = CalibrationConfig()
    duration: float = param(10.0, "simulated time of the run", unit="s", gt=0.0, le=86400.0)
    seed: int = param(1, "seed of everything random", ge=0, le=2**63 - 1)
    targets: list[TargetConfig] = param([], "desired poses over time")
    user_forces: list[UserForceConfig] = param([], "grasp forces that the user asks for over time")
    goal: GoalConfig = GoalConfig()
    plant: PlantConfig = PlantConfig()
    tactile_sensor: TactileSensorConfig = TactileSensorConfig()
    slip_regulator: SlipRegulatorConfig = SlipRegulatorConfig()
    force_optimizer: ForceOptimizerConfig = ForceOptimizerConfig()
    manipulation_controller: ControllerConfig = ControllerConfig()

    @model_validator(mode="before")
    @classmethod
    def _share(cls, data: Any) -> Any:
        """Pass shared values from the top level to every node that needs them."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        for node in NODES:
            section, model = data.get(node, {}), cls.model_fields[node].annotation
            assert isinstance(model, type) and issubclass(model, Config)
            shared = [name for name in _SHARED if name in model.model_fields]
            top = {name: data.get(name, cls.model_fields[name].default) for name in shared}
            if isinstance(section, Config):  # its defaults would silently contradict the top level
                raise ValueError(f"give '{node}' as a mapping, not as {type(section).__name__}")
            if section is None:  # it would hide what the extended scenario says
                raise ValueError(f"'{node}' is empty; give its keys, or leave it out")
            if not isinstance(section, dict):
                continue  # validation reports the error
            if wrong := [name for name in shared if name in section]:
                raise ValueError(f"set '{wrong[0]}' once at the top, not in '{node}'")
            # Defaults too: those of a node may differ from those of the scenario.
            data[node] = {**section, **top}
        return merged(_derived(data), data)

    @model_validator(mode="after")
    def _the_regulator_takes_each_user_force(self) -> Scenario:
        c = self.slip_regulator
        for force in (each.force for each in self.user_forces):
            if c.mode == "auto":
                raise ValueError(
                    "user_forces change nothing where slip_regulator.mode is auto; set it to user "
                    "or shared"
                )
            if not c.minimum <= force <= c.maximum:
                raise ValueError(
                    f"user_forces has {force:g} N, expected {c.minimum:g} to {c.maximum:g} N, the "
                    "minimum and the maximum of slip_regulator"
                )
        return self

    @model_validator(mode="after")
    def _the_hold_stays_inside_the_crush_limit(self) -> Scenario:
        hold, limit = self.plant.guard.hold.internal_force_limit, self.slip_regulator.maximum
        if hold > limit:
            raise ValueError(
                f"plant.guard.hold.internal_force_limit = {hold:g} N is above "
                f"slip_regulator.maximum = {limit:g} N; lower it, or leave it out to take over "
                "that limit"
            )
        return self

    @model_validator(mode="after")
    def _targets_are_in_order(self) -> Scenario:
        times = [t.time for t in self.targets]
        if times != sorted(times):
            raise ValueError(f"targets must be in order of time, got {times}")
        if times and times[-1] >= self.duration:
            raise ValueError(
                f"the last target comes at {times[-1]} s, but the run ends at {self.duration} s"
            )
        return self

    def changed(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a validated copy with other values, by dotted key (``plant.rate``).

        A user law is imported if the changes concern the controller, otherwise not.

        Raises:
            ConfigurationError: If a key or value is wrong; names it.
        """
        data = plain(self)
        put_changes(data, changes)
        wanted = validate(Scenario, data, "the scenario with these changes")
        if any(key.split(".")[0] in ("law", CONTROLLER) for key in changes):
            take_law(wanted.manipulation_controller.law)
        return wanted

    @property
    def ticks(self) -> int:
        """Number of ticks in the run; the first is at 0 s and the last at the duration."""
        return round(self.duration * self.plant.rate) + 1


def _derived(data: dict[str, Any]) -> dict[str, Any]:
    """Return the values that follow from others unless they are set, as a part of a scenario.

    `data` is a scenario before validation, which reports invalid sections.
    """
    plant, regulator = data["plant"], data["slip_regulator"]
    if not isinstance(plant, dict) or not isinstance(regulator, dict):
        return {}
    limit = regulator.get("maximum", SlipRegulatorConfig.model_fields["maximum"].default)
    seen = {}
    with suppress(ValidationError):
        seen["resolution"] = EncoderConfig.model_validate(plant.get("encoder", {})).resolution
    return {
        "plant": {"guard": {"hold": {"internal_force_limit": limit, **seen}}},
        CONTROLLER: {
            "hold": seen,
            "grasp_force_limit": limit,
            "touch_latency": _touch_latency(data),
            "imu": bool(plant.get("palm_motion")),
        },
    }


def _touch_latency(data: dict[str, Any]) -> float:
    """Return the largest age of forces: latency plus sample time of the skin.

    The sample time is at least what the controller assumes.
    """
    sensor, late = data["tactile_sensor"], float(ControllerConfig().touch_latency)
    try:
        own, rate = (float(sensor.get(name, 0.0)) for name in ("latency", "rate"))
    except (AttributeError, TypeError, ValueError):
        return late  # validation of the scenario reports the error
    apart = 1.0 / rate if rate > 0.0 else 0.0
    return min(max(late, apart) + max(own, 0.0), 0.5)  # the controller's maximum


def plain(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as plain data that validates back to the same values."""
    data = scenario.model_dump(mode="json")
    for node in NODES:
        for name in _SHARED:  # set once at the top level
            data[node].pop(name, None)
    _remove(data, _derived(data))
    return data


def _remove(data: dict[str, Any], known: Mapping[str, Any]) -> None:
    """Remove the values from nested data that are known."""
    for key, value in known.items():
        if isinstance(value, dict):
            _remove(data[key], value)
        elif data[key] == value:
            del data[key]


def resolved(scenario: Scenario) -> str:
    """Return a scenario as YAML text that `load_scenario` reads back to the same values."""
    return yaml_text(plain(scenario))


def load_scenario(name: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Load a scenario by name or path, and its user law if it names one.

    Args:
        name: Name of a scenario of the package, or path of a YAML file.
        changes: Values that replace those of the file, by dotted key (``plant.rate``).

    Raises:
        ConfigurationError: If it does not exist, or a key or value is wrong; names its place.
    """
    path, changes = find_file("scenario", name), changes or {}
    data = read_layers(path)
    data.setdefault("name", path.stem)
    put_changes(data, changes)
    source = f"{path} with changes of {', '.join(changes)}" if changes else str(path)
    scenario = validate(Scenario, data, source)
    _check_times(scenario, str(path), changes)
    take_law(scenario.manipulation_controller.law)
    return scenario


def _check_times(scenario: Scenario, file: str, changes: Mapping[str, Any]) -> None:
    """Reject events that are planned for after the end of the run.

    A change may shorten the run below the times in its file.
    """
    plant = scenario.plant
    planned = {
        "plant.disturbances": [push.start for push in plant.disturbances],
        "plant.friction_changes": [change.start for change in plant.friction_changes],
        "user_forces": [request.time for request in scenario.user_forces],
    }
    for place, times in planned.items():
        is_cut_short = "duration" in changes and place not in changes
        late = [time for time in times if time >= scenario.duration and not is_cut_short]
        if late:
            raise ConfigurationError(
                f"{file}: one of {place} comes at {late[0]:g} s, but the run ends at "
                f"{scenario.duration:g} s; make the run longer"
            )
