# SPDX-License-Identifier: Apache-2.0
"""Typed configuration: one declaration for YAML files, ROS parameters and documentation."""

from __future__ import annotations

import copy
import enum
import functools
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo

from tactile_hand_ros.config.untrusted import check_yaml, read_text
from tactile_hand_ros.errors import ConfigurationError, nearest

C = TypeVar("C", bound="Config")
_SEQUENCES = (list, tuple)
_MOST_LISTED = 30  # names in a sentence
_LARGEST = 2**17  # bytes of a YAML file; its parser reads some 50 kB a second


def param(
    default: Any, description: str, *, unit: str = "", live: bool = False, **constraints: Any
) -> Any:
    """Declare one configuration field.

    Args:
        default: Value used when none is given; ``...`` makes the field required.
        description: One phrase for help texts and documentation.
        unit: SI unit, empty for pure numbers and names.
        live: Whether the value may change while the system runs.
        **constraints: pydantic constraints such as ``ge``, ``gt``, ``le``, ``lt``, ``min_length``.

    Returns:
        A pydantic field for use in a `Config`.
    """
    extra: dict[str, Any] = {"unit": unit, "live": live}
    return Field(default, description=description, json_schema_extra=extra, **constraints)


class Config(BaseModel):
    """Base of all configuration models: immutable, no unknown keys, finite numbers only."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_default=True,
        use_enum_values=False,
    )

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_lookalikes(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse ``true`` and ``"1"`` where a number is meant; pydantic would convert them."""
        annotation = cls.model_fields[str(info.field_name)].annotation
        if element_type(annotation) in (int, float):
            items = value if isinstance(value, _SEQUENCES) else (value,)
            if any(isinstance(item, bool | str) for item in items):
                raise ValueError(f"{value!r} is not a number")
        return value

    def changed(self: C, changes: Mapping[str, Any]) -> C:
        """Return a validated copy with other values.

        Args:
            changes: New values by dotted name, e.g. ``{"object.mass": 0.2}``.

        Raises:
            ConfigurationError: If a name is unknown or a value is refused.
        """
        return from_flat(type(self), {**flatten(self), **changes})


def unit_of(field: FieldInfo) -> str:
    """Return the unit declared with `param`, empty if none."""
    return str(_extra(field).get("unit", ""))


def is_live(field: FieldInfo) -> bool:
    """Return whether the field was declared with ``live=True``."""
    return bool(_extra(field).get("live", False))


def _extra(field: FieldInfo) -> Mapping[str, Any]:
    extra = field.json_schema_extra
    return extra if isinstance(extra, Mapping) else {}


def is_config(annotation: Any) -> bool:
    """Return whether a type is a nested `Config`."""
    return isinstance(annotation, type) and issubclass(annotation, Config)


def element_type(annotation: Any) -> Any:
    """Return the item type of a list or tuple type without its constraints, else the type."""
    if typing.get_origin(annotation) not in _SEQUENCES:
        return annotation
    item = typing.get_args(annotation)[0]
    return typing.get_args(item)[0] if typing.get_origin(item) is typing.Annotated else item


def is_sequence(annotation: Any) -> bool:
    """Return whether a type is a list or tuple of something."""
    return typing.get_origin(annotation) in _SEQUENCES


def leaves(model: type[Config], prefix: str = "") -> dict[str, FieldInfo]:
    """Return the fields of a model and of the models nested in it, by dotted name."""
    found: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        if is_config(field.annotation):
            found |= leaves(typing.cast("type[Config]", field.annotation), f"{prefix}{name}.")
        else:
            found[prefix + name] = field
    return found


def flatten(config: Config, prefix: str = "") -> dict[str, Any]:
    """Return the values of a configuration by dotted name; nested lists of models stay models."""
    flat: dict[str, Any] = {}
    for name in type(config).model_fields:
        value = getattr(config, name)
        if is_config(type(config).model_fields[name].annotation):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def from_flat(model: type[C], values: Mapping[str, Any], source: str = "") -> C:
    """Build a configuration from values by dotted name.

    Raises:
        ConfigurationError: If a name is unknown or a value is refused.
    """
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parents, last = name.split(".")
        node: Any = tree
        for parent in parents:
            node = node.setdefault(parent, {}) if isinstance(node, dict) else None
        if not isinstance(node, dict):
            hint = did_you_mean(name, leaves(model))
            message = f"{_before(source)}unknown key '{name}'{hint}"
            raise ConfigurationError(message, source=source, place=name)
        node[last] = value
    return validate(model, tree, source)


Source = str | Callable[[str], str]
"""Where a value came from: the name of a file or interface, or a function of its dotted place."""


def validate(model: type[C], data: Any, source: Source = "") -> C:
    """Validate plain data against a model.

    Args:
        model: The configuration class.
        data: Nested mappings as read from YAML.
        source: Where it came from, for the error text.

    Raises:
        ConfigurationError: With source, dotted place and allowed values of every mistake.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explain(error, model, source) from None


def load_yaml(path: str | Path, model: type[C]) -> C:
    """Read a YAML file into a configuration.

    Raises:
        ConfigurationError: If the file cannot be read, is not YAML or does not fit the model.
    """
    return validate(model, read_yaml(path), str(path))


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file as plain data; an empty file is an empty mapping.

    Raises:
        ConfigurationError: If the file cannot be read, is too large, is not YAML or repeats a key.
    """
    return parse_yaml(read_text(path, _LARGEST), str(path))


def parse_yaml(text: str, source: str = "") -> Any:
    """Parse YAML text as plain data; empty text is an empty mapping.

    Raises:
        ConfigurationError: If the text is not YAML or repeats a key.
    """
    try:
        data = copy.deepcopy(_parsed(text))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else "this file"
        problem = getattr(error, "problem", None) or "it cannot be parsed"
        message = f"{_before(source)}{place} is not valid YAML: {problem}."
        raise ConfigurationError(message, source=source, place=place) from None
    return {} if data is None else data


def parse_changes(changes: Sequence[str], example: str = "plant.rate=250") -> dict[str, Any]:
    """Read ``key=value`` texts of a command line; values are YAML.

    Args:
        changes: The texts.
        example: A good one, for the error.

    Raises:
        ConfigurationError: If there is no ``=``, or the value is not YAML.
    """
    found: dict[str, Any] = {}
    for change in changes:
        key, separator, value = change.partition("=")
        if not separator or not key:
            raise ConfigurationError(f"--set got '{change}', expected key=value such as {example}")
        found[key] = parse_yaml(value, f"--set {key}")
    return found


@functools.lru_cache(maxsize=64)
def _parsed(text: str) -> Any:
    """Return what a text says; a study reads the same files a thousand times."""
    check_yaml(text)
    return yaml.load(text, Loader=_Loader)


class _Loader(yaml.SafeLoader):
    """YAML loader that refuses repeated keys and reads numbers as they look."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """Say where a value is that is not what it looks like, such as a 13th month."""
        try:
            return super().construct_object(node, deep=deep)
        except (ValueError, KeyError, AttributeError) as error:
            kind = node.tag.rpartition(":")[2]
            problem = f"{_short(node.value)} is no {kind} ({error})"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that is not text or appears twice: a value would be lost silently."""
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                problem = f"a {key.id} is not a key, expected text"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            if key.value in seen:
                problem = f"the key '{key.value}' appears twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return typing.cast("dict[Any, Any]", super().construct_mapping(node, deep=deep))

    def construct_whole_number(self, node: yaml.ScalarNode) -> int:
        """Read a whole number as it looks: 010 is ten, as in YAML 1.2, and not octal."""
        return int(self.construct_scalar(node), 10)


def _numbers_as_they_look(rules: type[yaml.SafeLoader] | type[yaml.SafeDumper]) -> None:
    """Let a reader or writer take numbers and truth values as YAML 1.2 does.

    YAML 1.1 reads 010 as 8, 1:30 as 90, 1_0 as 10, on and no as truth values, and 1e3 as text.
    """
    for tag, pattern, first in (
        ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
        ("int", r"[-+]?[0-9]+", "-+0123456789"),
        (
            "float",
            r"[-+]?(\.[0-9]+|[0-9]+\.[0-9]*)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
            r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
            "-+.0123456789",
        ),
    ):
        expression = re.compile(rf"^(?:{pattern})$")
        rules.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", expression, list(first))


_AS_IN_1_1 = {f"tag:yaml.org,2002:{kind}" for kind in ("bool", "int", "float", "timestamp")}
_Loader.yaml_implicit_resolvers = {
    first: [rule for rule in rules if rule[0] not in _AS_IN_1_1]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_numbers_as_they_look(_Loader)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole_number)


class _Dumper(yaml.SafeDumper):
    """YAML writer that quotes a text which YAML 1.1 or 1.2 would read as something else."""


_numbers_as_they_look(_Dumper)


def yaml_text(data: Any) -> str:
    """Return plain data as YAML that `parse_yaml` reads back."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)
    return text


def explain(
    error: ValidationError, model: type[BaseModel], source: Source = ""
) -> ConfigurationError:
    """Turn pydantic's findings into one sentence each: place, what was given, what is allowed."""
    findings = _said_once(error.errors(include_url=False))
    places = [_place(finding["loc"]) for finding in findings]
    sources = [source if isinstance(source, str) else source(place) for place in places]
    lines = [_before(s) + _sentence(f, model) for s, f in zip(sources, findings, strict=True)]
    return ConfigurationError("\n".join(lines), source=sources[0], place=places[0])


def _said_once(findings: Sequence[Any]) -> list[Any]:
    """Leave out what is wrong in a section only because it repeats a value of the top."""
    known = {(finding["loc"], repr(finding.get("input"))) for finding in findings}
    return [
        finding
        for finding in findings
        if len(finding["loc"]) < 2 or (finding["loc"][1:], repr(finding.get("input"))) not in known
    ]


def _before(source: str) -> str:
    return f"{source}: " if source else ""


def _place(location: Iterable[int | str]) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def _sentence(finding: Any, model: type[BaseModel]) -> str:
    location, kind, given = finding["loc"], finding["type"], finding.get("input")
    place = _place(location) or "the content"
    if kind == "extra_forbidden":
        return _unknown_key(location, model)
    if kind == "missing":
        return f"{place} is missing, expected {allowed_at(model, location)}."
    if kind in ("value_error", "assertion_error") and not _is_lookalike(finding):
        reason = str(finding["ctx"]["error"]).rstrip(".")
        return f"{place} is refused: {reason}." if location else f"{reason}."
    expected = allowed_at(model, location)
    if location and isinstance(location[-1], int):  # an item's limits are not the list's
        expected = " ".join([expected, *_phrases(finding.get("ctx", {}).get)])
    return f"{place} is {_short(given)}, expected {expected}."


def _is_lookalike(finding: Any) -> bool:
    return str(finding["ctx"]["error"]).endswith("is not a number")


def _short(value: Any, limit: int = 60) -> str:
    text = repr(value.value) if isinstance(value, enum.Enum) else repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _unknown_key(location: tuple[int | str, ...], model: type[BaseModel]) -> str:
    parent, _ = _walk(model, location[:-1])
    valid = list(parent.model_fields) if _is_model(parent) else []
    where = f" in {_place(location[:-1])}" if len(location) > 1 else ""
    return f"unknown key '{location[-1]}'{where}{did_you_mean(str(location[-1]), valid)}"


def did_you_mean(wrong: str, valid: Iterable[str]) -> str:
    """Return a suffix that ends the sentence with the nearest valid name and, if few, with all."""
    names = sorted(valid)
    hint = nearest(wrong, names)
    if len(names) > _MOST_LISTED:
        return f"{hint} `tactile-hand show paper` lists all {len(names)}."
    return f"{hint} Valid are: {', '.join(names)}." if names else hint


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _walk(model: type[BaseModel], location: Iterable[int | str]) -> tuple[Any, FieldInfo | None]:
    """Follow a location to its type and the field that declares it; unknown steps are skipped."""
    annotation: Any = model
    field: FieldInfo | None = None
    for part in location:
        if isinstance(part, int):
            annotation = element_type(annotation)
        elif _is_model(annotation) and part in annotation.model_fields:
            field = annotation.model_fields[part]
            annotation = field.annotation
    return annotation, field


def allowed_at(model: type[BaseModel], location: Iterable[int | str]) -> str:
    """Describe in words what a place in a model accepts."""
    location = tuple(location)
    annotation, field = _walk(model, location)
    if not location or field is None:
        return "a mapping of " + ", ".join(model.model_fields)
    return allowed(annotation, field)


def allowed(annotation: Any, field: FieldInfo) -> str:
    """Describe in words what a field accepts, e.g. ``a finite number >= 0 and <= 1 N``."""
    text = _kind(annotation)
    limits = _limits(field)
    if limits:
        text += " " + " and ".join(limits)
    unit = unit_of(field)
    return f"{text} {unit}" if unit else text


_KINDS = {float: "a finite number", int: "a whole number", bool: "true or false", str: "a text"}


def _kind(annotation: Any) -> str:
    choices = choices_of(annotation)
    if choices:
        return "one of " + ", ".join(choices)
    if is_sequence(annotation):
        return f"a list of which each item is {_kind(element_type(annotation))}"
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        kinds = [_kind(part) for part in typing.get_args(annotation)]
        return " or ".join(kinds)
    if _is_model(annotation):
        return "a mapping of " + ", ".join(annotation.model_fields)
    if annotation is type(None):
        return "nothing"
    return _KINDS.get(annotation, "a valid value")


def choices_of(annotation: Any) -> list[str]:
    """Return the accepted names of a Literal or Enum type, empty for other types."""
    if typing.get_origin(annotation) is typing.Literal:
        return [str(choice) for choice in typing.get_args(annotation)]
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return [str(member.value) for member in annotation]
    return []


_LIMITS: tuple[tuple[str, Callable[[Any], str]], ...] = (
    ("ge", lambda bound: f">= {bound}"),
    ("gt", lambda bound: f"> {bound}"),
    ("le", lambda bound: f"<= {bound}"),
    ("lt", lambda bound: f"< {bound}"),
    ("min_length", lambda bound: f"with at least {bound} items"),
    ("max_length", lambda bound: f"with at most {bound} items"),
)


def _limits(field: FieldInfo) -> list[str]:
    return _phrases(lambda name: bound_of(field, name))


def _phrases(bound_named: Callable[[str], Any]) -> list[str]:
    bounds = ((phrase, bound_named(name)) for name, phrase in _LIMITS)
    return [phrase(bound) for phrase, bound in bounds if bound is not None]


def bound_of(field: FieldInfo, name: str) -> Any:
    """Return a constraint (``ge``, ``gt``, ``le``, ``lt``, ...) of a field, None if not set."""
    for item in field.metadata:
        bound = getattr(item, name, None)
        if bound is not None:
            return bound
    return None
