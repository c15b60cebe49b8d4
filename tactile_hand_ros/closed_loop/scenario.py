# SPDX-License-Identifier: Apache-2.0
"""Scenarios: one typed YAML file that says everything about a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import model_validator

from tactile_hand_ros.config.model import (
    Config,
    did_you_mean,
    param,
    parse_yaml,
    read_yaml,
    validate,
)
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.control.slip.regulator import SlipRegulatorConfig
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.simulation.plant_config import ObjectConfig, PlantConfig
from tactile_hand_ros.simulation.skin import TactileSensorConfig

Vector = tuple[float, float, float]

_MAX_DEPTH = 8  # of scenarios that extend each other
# What is said once for the whole scenario and handed to every node that has such a parameter.
_SHARED = ("hand", "layout", "gravity", "seed", "duration")
NODES = ("plant", "tactile_sensor", "slip_regulator", "force_optimizer", "manipulation_controller")


class TargetConfig(Config):
    """A desired pose and when it is commanded."""

    time: float = param(0.0, "simulated time of the command", unit="s", ge=0.0)
    position: Vector = param(..., "p_d of the contact centroid, palm frame", unit="m")
    rotation: Vector = param((0.0, 0.0, 0.0), "R_pod as a rotation vector, palm frame", unit="rad")

    @property
    def stamp(self) -> int:
        """The tick of the command, ns."""
        return round(self.time * 1e9)

    def target(self) -> Target:
        """Return position and orientation as arrays."""
        return Target(np.array(self.position), rotation_from_vector(self.rotation))


class UserForceConfig(Config):
    """A squeeze that the user asks for, and when.

    `ClosedLoop` takes it at that very tick. Over ROS it is sent when the orchestrator sees that the
    time has come, as a user would, and so arrives some ticks later, not always as many.
    """

    time: float = param(0.0, "simulated time of the request", unit="s", ge=0.0)
    force: float = param(..., "k_f", unit="N", gt=0.0)

    @property
    def stamp(self) -> int:
        """The tick of the request, ns."""
        return round(self.time * 1e9)


class GoalConfig(Config):
    """What counts as having reached the last target."""

    position_error: float = param(0.001, "largest final position error", unit="m", gt=0.0)
    rotation_error: float = param(0.01, "largest final orientation error |r_d|", unit="rad", gt=0.0)
    slip_distance: float = param(
        1.0, "largest distance that a contact may slide in all", unit="m", gt=0.0
    )


class Scenario(Config):
    """One experiment: hand, object, gains, sensors, targets over time."""

    name: str = param("", "name, by default that of the file")
    description: str = param("", "what happens and why, in a sentence")
    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    gravity: Vector = param((0.0, 0.0, 0.0), "acceleration of gravity, palm frame", unit="m/s^2")
    duration: float = param(10.0, "simulated time of the run", unit="s", gt=0.0, le=86400.0)
    seed: int = param(1, "seed of everything random", ge=0)
    targets: list[TargetConfig] = param([], "desired poses over time")
    user_forces: list[UserForceConfig] = param([], "squeezes that the user asks for over time")
    goal: GoalConfig = GoalConfig()
    plant: PlantConfig = PlantConfig()
    tactile_sensor: TactileSensorConfig = TactileSensorConfig()
    slip_regulator: SlipRegulatorConfig = SlipRegulatorConfig()
    force_optimizer: ForceOptimizerConfig = ForceOptimizerConfig()
    manipulation_controller: ControllerConfig = ControllerConfig()

    @model_validator(mode="before")
    @classmethod
    def _share(cls, data: Any) -> Any:
        """Hand what is said once, at the top, to every node that needs it."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        for node in NODES:
            section, model = data.get(node) or {}, cls.model_fields[node].annotation
            assert isinstance(model, type) and issubclass(model, Config)
            shared = [name for name in _SHARED if name in model.model_fields]
            top = {name: data.get(name, cls.model_fields[name].default) for name in shared}
            if isinstance(section, model):
                section = _unshared(section, top)
            if not isinstance(section, dict):
                continue  # nonsense that validation will name
            if wrong := [name for name in shared if name in section]:
                raise ValueError(f"set '{wrong[0]}' once at the top, not in '{node}'")
            # Defaults too: those of a node need not be those of the scenario.
            data[node] = {**section, **top}
        return data

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
        """Return a validated copy with other values, see the function of this name."""
        return changed(self, changes)

    @property
    def ticks(self) -> int:
        """Number of ticks in the run; the first is at 0 s and the last at the duration."""
        return round(self.duration * self.plant.rate) + 1

    def node_config(self, node: str) -> Config:
        """Return the parameters of a node by its name."""
        section: Config = getattr(self, node)
        return section


def _unshared(section: Config, top: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a finished section without those that only repeat the scenario's.

    Defaults were not given by a user, so they go as well.
    """
    values = {name: getattr(section, name) for name in type(section).model_fields}
    for name, given in top.items():
        own, default = values[name], type(section).model_fields[name].default
        if np.array_equal(own, default) or np.array_equal(own, given):
            del values[name]
    return values


def resolved(scenario: Scenario) -> str:
    """Return a scenario as YAML text that `load_scenario` reads back to the same values."""
    data = scenario.model_dump(mode="json")
    for node in NODES:
        for name in _SHARED:  # said once at the top
            data[node].pop(name, None)
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)
    return text


def changed(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """Return a scenario with other values, by dotted key (``plant.rate``).

    Raises:
        ConfigurationError: If a key or value is wrong; says which.
    """
    data = parse_yaml(resolved(scenario), "the scenario")
    for key, value in changes.items():
        _put(data, key.split("."), value)
    return validate(Scenario, data, "the changed scenario")


def object_config(data: Any, source: str) -> ObjectConfig:
    """Read the object alone, for those who draw a scenario that they may not be able to run.

    Args:
        data: Content of the key ``plant.object``.
        source: Where it came from, for the error text.

    Raises:
        ConfigurationError: If a key or value is wrong.
    """
    return validate(ObjectConfig, data, source)


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in (config_directory() / "scenarios").glob("*.yaml"))


def find_scenario(name: str) -> Path:
    """Return the file of a scenario given by name (``paper``) or by path (``my/run.yaml``).

    Raises:
        ConfigurationError: If neither a file nor a scenario of that name exists.
    """
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return path
        raise ConfigurationError(
            f"scenario file '{path}' does not exist; give a YAML file or one of: "
            + ", ".join(scenario_names())
        )
    if name in scenario_names():
        return config_directory() / "scenarios" / f"{name}.yaml"
    raise ConfigurationError(
        f"no scenario is called '{name}'{did_you_mean(name, scenario_names())} Give one of them or "
        "the path of a YAML file"
    )


def load_scenario(name: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Load a scenario by name or path.

    Args:
        name: Name of a scenario of the package, or path of a YAML file.
        changes: Values to put over those of the file, by dotted key (``plant.rate``).

    Raises:
        ConfigurationError: If it does not exist, or a key or value is wrong; says which and where.
    """
    path = find_scenario(name)
    data = _read(path, ())
    for key, value in (changes or {}).items():
        _put(data, key.split("."), value)
    data.setdefault("name", path.stem)
    return validate(Scenario, data, str(path))


def _read(path: Path, seen: tuple[Path, ...]) -> dict[str, Any]:
    """Read a scenario and lay it over the one that it extends."""
    path = path.resolve()
    if path in seen or len(seen) >= _MAX_DEPTH:
        chain = " -> ".join(p.stem for p in (*seen, path))
        raise ConfigurationError(f"scenarios extend each other in a circle: {chain}")
    data = read_yaml(path)
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigurationError(
            f"'{path}' holds {type(data).__name__}; expected a mapping of keys to values"
        )
    base = data.pop("extends", None)
    if base is None:
        return data
    under = _read(_find_base(str(base), path), (*seen, path))
    under.pop("name", None)
    return _merged(under, data)


def _find_base(base: str, path: Path) -> Path:
    """Return the scenario that another extends: beside it, else by name or path.

    A user's ``paper.yaml`` may extend ``paper``, which then is the one of the package.
    """
    beside = path.parent / (base if base.endswith((".yaml", ".yml")) else f"{base}.yaml")
    return beside if beside.is_file() and beside.resolve() != path else find_scenario(base)


def _merged(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Lay mappings over each other key by key; lists and values are replaced whole."""
    out = dict(under)
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict):
            value = _merged(out[key], value)
        out[key] = value
    return out


def _put(data: dict[str, Any], keys: list[str], value: Any) -> None:
    """Set a value by its path.

    Raises:
        ConfigurationError: If the path leads through something that has no keys.
    """
    place: Any = data
    for index, key in enumerate(keys):
        if not isinstance(place, dict):
            raise ConfigurationError(
                f"'{'.'.join(keys)}' cannot be set: '{'.'.join(keys[:index])}' has no keys in it; "
                "set it as a whole"
            )
        if index == len(keys) - 1:
            place[key] = value
        else:
            place = place.setdefault(key, {})
