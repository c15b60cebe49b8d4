# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from a configuration model: types, ranges, validation, files and documentation."""

from __future__ import annotations

import enum
import json
import sys
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import yaml
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from tactile_hand_ros.config.explanation import (
    allowed,
    choices_of,
    did_you_mean,
    element_type,
    is_live,
    is_sequence,
    unit_of,
)
from tactile_hand_ros.config.model import Config, flatten, from_flat, is_config, leaves
from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.ros.endpoints import described

C = TypeVar("C", bound=Config)
Type = Parameter.Type

_SCALARS = {bool: Type.BOOL, int: Type.INTEGER, float: Type.DOUBLE, str: Type.STRING}
_ARRAYS = {
    Type.BOOL: Type.BOOL_ARRAY,
    Type.INTEGER: Type.INTEGER_ARRAY,
    Type.DOUBLE: Type.DOUBLE_ARRAY,
    Type.STRING: Type.STRING_ARRAY,
}
_OF_ROS = ("use_sim_time", "start_type_description_service")
_QOS_PREFIX = "qos_overrides."
_LONGEST_REASON = 2000  # characters; a reason may quote the value


class ConfigParameters(Generic[C]):
    """The parameters of one node, declared from a model and kept equal to a validated config.

    A change is atomic: it is accepted or rejected as a whole.

    Attributes:
        config: The configuration in force.
    """

    def __init__(
        self,
        node: Node,
        model: type[C],
        on_change: Callable[[C], None] = lambda _: None,
        check: Callable[[C], None] = lambda _: None,
    ) -> None:
        """Declare every field of the model, a configuration class, with its initial value.

        Each change calls `check` with the new configuration before it is accepted, which may raise
        TactileHandError, and `on_change` after.

        Raises:
            ConfigurationError: If a given value is rejected or no field has the given name.
        """
        self._node, self._source = node, node.get_fully_qualified_name()
        self._fields = leaves(model)
        self._on_change, self._further_check = on_change, check
        self.config: C = from_flat(model, self._given(), source=self._source)
        self._declare()
        node.add_pre_set_parameters_callback(self._with_declared_types)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _given(self) -> dict[str, Any]:
        """Return the values set by files and command line, by field name."""
        # rclpy has no public access to overrides before they are declared.
        overrides: Mapping[str, Parameter] = self._node._parameter_overrides
        known = {*self._fields, *_OF_ROS}
        self._refuse([n for n in overrides if n not in known and not n.startswith(_QOS_PREFIX)])
        return {
            name: from_ros(field, overrides[name].value, f"{self._source}: {name}")
            for name, field in self._fields.items()
            if name in overrides
        }

    def _refuse(self, unknown: list[str]) -> None:
        """Reject unknown parameters; only warn about those of a file, which other nodes may use."""
        for name in unknown:
            hint = did_you_mean(name, list(self._fields))
            set_here = f"{name}:=", f"{self._node.get_name()}:{name}:="
            if any(word.startswith(set_here) for word in sys.argv):
                raise ConfigurationError(f"{self._source}: unknown parameter '{name}'{hint}")
            self._node.get_logger().warning(f"ignored the unknown parameter '{name}'{hint}")

    def _declare(self) -> None:
        """Declare the types, then set the values; otherwise an empty array would lose its type."""
        types = [(name, ros_type(field), descriptor(field)) for name, field in self._fields.items()]
        self._node.declare_parameters("", types, ignore_override=True)
        values = flatten(self.config)
        result = self._node.set_parameters_atomically(
            [to_parameter(name, field, values[name]) for name, field in self._fields.items()]
        )
        if not result.successful:
            raise ConfigurationError(f"{self._source}: {result.reason}.")
        for name, field in self._fields.items():
            if not is_live(field):
                self._node.set_descriptor(name, descriptor(field, read_only=True))

    def _with_declared_types(self, parameters: list[Parameter]) -> list[Parameter]:
        """Accept ``1`` as ``1.0`` and give empty arrays their declared type."""
        return [
            _retyped(parameter, ros_type(self._fields[parameter.name]))
            if parameter.name in self._fields
            else parameter
            for parameter in parameters
        ]

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._further_check(self._candidate(parameters))
        except TactileHandError as error:
            return SetParametersResult(successful=False, reason=str(error)[:_LONGEST_REASON])
        except Exception as error:  # such as nesting that is too deep for the validation
            return SetParametersResult(successful=False, reason=described(error))
        return SetParametersResult(successful=True)

    def _candidate(self, parameters: list[Parameter]) -> C:
        changes = {
            parameter.name: from_ros(self._fields[parameter.name], parameter.value, parameter.name)
            for parameter in parameters
            if parameter.name in self._fields
        }
        return self.config.changed(changes)

    def _apply(self, parameters: list[Parameter]) -> None:
        if any(parameter.name in self._fields for parameter in parameters):
            self.config = self._candidate(parameters)
            self._on_change(self.config)


def _retyped(parameter: Parameter, wanted: Parameter.Type) -> Parameter:
    value = parameter.value
    if parameter.type_ is Type.INTEGER and wanted is Type.DOUBLE:
        return Parameter(parameter.name, Type.DOUBLE, float(value))
    if parameter.type_ is Type.INTEGER_ARRAY and wanted is Type.DOUBLE_ARRAY:
        return Parameter(parameter.name, Type.DOUBLE_ARRAY, [float(item) for item in value])
    if wanted in _ARRAYS.values() and parameter.type_ in _EMPTY_ARRAYS and not len(value):
        return Parameter(parameter.name, wanted, [])
    return parameter


_EMPTY_ARRAYS = (Type.BYTE_ARRAY, *_ARRAYS.values())


def ros_type(field: FieldInfo) -> Parameter.Type:
    """Return the ROS parameter type of a field."""
    item = element_type(field.annotation)
    scalar = Type.STRING if choices_of(item) or is_config(item) else _SCALARS[item]
    return _ARRAYS[scalar] if is_sequence(field.annotation) else scalar


def from_ros(field: FieldInfo, value: Any, place: str = "") -> Any:
    """Convert the value of a ROS parameter to a value of the field.

    Raises:
        ConfigurationError: If a list item that must be a YAML mapping is not valid YAML.
    """
    if not is_sequence(field.annotation):
        # Unlike ROS types, a configuration accepts 1 for 1.0.
        return float(value) if type(value) is int and field.annotation is float else value
    items = [] if value is None else list(value) if not isinstance(value, str) else value
    if is_config(element_type(field.annotation)) and isinstance(items, list):
        return [parse_yaml(item, place) if isinstance(item, str) else item for item in items]
    return items


def to_ros(value: Any) -> Any:
    """Convert the value of a field to the value of a ROS parameter."""
    if isinstance(value, (list, tuple)):
        return [to_ros(item) for item in value]
    if isinstance(value, Config):
        data = value.model_dump(mode="json")
        return yaml.safe_dump(data, default_flow_style=True, sort_keys=False, width=10**9).strip()
    return value.value if isinstance(value, enum.Enum) else value


def to_parameter(name: str, field: FieldInfo, value: Any) -> Parameter:
    """Return a field's value as a ROS parameter of the field's type."""
    return Parameter(name, ros_type(field), to_ros(value))


def to_parameters(config: Config) -> list[ParameterMessage]:
    """Return all values of a configuration as messages."""
    fields = leaves(type(config))
    return [
        to_parameter(name, fields[name], value).to_parameter_msg()
        for name, value in flatten(config).items()
    ]


def descriptor(field: FieldInfo, *, read_only: bool = False) -> ParameterDescriptor:
    """Return the ROS descriptor of a field: text, unit, type, allowed values and read-only flag."""
    unit = unit_of(field)
    return ParameterDescriptor(
        type=ros_type(field).value,
        description=f"{field.description or ''} [{unit}]" if unit else field.description or "",
        additional_constraints=allowed(field.annotation, field),
        read_only=read_only,
    )


def to_params_yaml(config: Config, node_name: str) -> str:
    """Return a configuration as text for ``--params-file``, for a node in any namespace."""
    # JSON, one line per value: rcl does not read unquoted words such as y or 1e3 as strings.
    lines = [
        f"    {name}: {json.dumps(to_ros(value), ensure_ascii=False)}\n"
        for name, value in flatten(config).items()
    ]
    return f"/**/{node_name}:\n  ros__parameters:\n{''.join(lines)}"
