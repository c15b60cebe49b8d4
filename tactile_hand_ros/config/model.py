# SPDX-License-Identifier: Apache-2.0
"""Typed configuration: one declaration for YAML files, ROS parameters and documentation."""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping
from operator import attrgetter
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo

from tactile_hand_ros.config.explanation import (
    SEQUENCES,
    after_source,
    did_you_mean,
    element_type,
    explain,
    unit_of,
)
from tactile_hand_ros.errors import ConfigurationError

C = TypeVar("C", bound="Config")
_FULL_TURN = 2.0 * math.pi + 1e-3  # rad; tolerates a rounded value


def param(
    default: Any, description: str, *, unit: str = "", live: bool = False, **constraints: Any
) -> Any:
    """Declare one field of a `Config`.

    Args:
        default: Value used when none is given; ``...`` makes the field required.
        description: One phrase for help texts and documentation.
        unit: SI unit, empty for pure numbers and names.
        live: Whether the value may change while the system runs.
        **constraints: pydantic constraints such as ``ge``, ``gt``, ``le``, ``lt``, ``min_length``.
    """
    extra: dict[str, Any] = {"unit": unit, "live": live}
    return Field(default, description=description, json_schema_extra=extra, **constraints)


class Config(BaseModel):
    """Base of all configuration models: immutable, no unknown keys, finite numbers only."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_lookalikes(cls, value: Any, info: ValidationInfo) -> Any:
        """Reject ``true`` for a number; pydantic would convert it.

        Text such as ``1e3`` is a number: only YAML 1.1 parses it as text.
        """
        annotation = cls.model_fields[str(info.field_name)].annotation
        if element_type(annotation) in (int, float):
            items = value if isinstance(value, SEQUENCES) else (value,)
            if any(isinstance(item, bool) for item in items):
                raise ValueError("true or false is not a number")
        return value

    @field_validator("*")
    @classmethod
    def _refuse_degrees(cls, value: Any, info: ValidationInfo) -> Any:
        angles = value if isinstance(value, SEQUENCES) else [value or 0.0]
        is_angle = unit_of(cls.model_fields[str(info.field_name)]) == "rad"
        if is_angle and any(abs(angle) > _FULL_TURN for angle in angles):
            raise ValueError(f"{value} goes beyond a full turn; angles are in rad, not degrees")
        return value

    def changed(self: C, changes: Mapping[str, Any]) -> C:
        """Return a validated copy with new values by dotted name, e.g. ``{"object.mass": 0.2}``.

        Raises:
            ConfigurationError: If a name is unknown or a value is rejected.
        """
        return from_flat(type(self), {**flatten(self), **changes})


def is_config(annotation: Any) -> bool:
    """Return whether a type is a nested `Config`."""
    return isinstance(annotation, type) and issubclass(annotation, Config)


def leaves(model: type[Config], prefix: str = "") -> dict[str, FieldInfo]:
    """Return the fields of a model and of the models nested in it, by dotted name."""
    found: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        if is_config(field.annotation):
            found |= leaves(typing.cast("type[Config]", field.annotation), f"{prefix}{name}.")
        else:
            found[prefix + name] = field
    return found


def flatten(config: Config) -> dict[str, Any]:
    """Return the values of a configuration by dotted name; nested lists of models stay models."""
    return {name: attrgetter(name)(config) for name in leaves(type(config))}


def from_flat(model: type[C], values: Mapping[str, Any], source: str = "") -> C:
    """Build a configuration from values by dotted name.

    Raises:
        ConfigurationError: If a name is unknown or a value is rejected.
    """
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parents, last = name.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
            if not isinstance(node, dict):
                message = f"unknown key '{name}'{did_you_mean(name, leaves(model))}"
                raise ConfigurationError(after_source(source) + message)
        node[last] = value
    return validate(model, tree, source)


def validate(model: type[C], data: Any, source: str = "") -> C:
    """Validate plain data, nested mappings as read from YAML, against a model.

    Raises:
        ConfigurationError: With source, dotted place and allowed values of the first mistake.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explain(error, model, source) from None
