# SPDX-License-Identifier: Apache-2.0
"""Describe the values that a field accepts, and why one is rejected."""

from __future__ import annotations

import enum
import reprlib
import typing
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from tactile_hand_ros.errors import ConfigurationError, nearest, shortened

_MOST_LISTED = 30  # names in a sentence


def explain(error: ValidationError, model: type[BaseModel], source: str = "") -> ConfigurationError:
    """Turn pydantic's first finding into a sentence: place, given value, allowed values."""
    finding = error.errors(include_url=False)[0]
    return ConfigurationError(after_source(source) + _sentence(finding, model))


def after_source(source: str) -> str:
    """Return a source as the start of a sentence; empty if unknown."""
    return f"{source}: " if source else ""


def _place(location: Iterable[int | str]) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def _sentence(finding: Any, model: type[BaseModel]) -> str:
    """Return pydantic's finding as a sentence with place, value, expectation and unit."""
    location, kind, told = finding["loc"], finding["type"], finding["msg"].rstrip(".")
    place, (fields, field) = _place(location) or "the content", _walk(model, location)
    unit = f" [{unit_of(field)}]" if field is not None and unit_of(field) else ""
    if kind == "extra_forbidden":
        where = f" in {_place(location[:-1])}" if len(location) > 1 else ""
        return f"unknown key '{location[-1]}'{where}{did_you_mean(str(location[-1]), fields)}"
    if kind == "missing":
        return f"{place} is missing, expected the {field.description if field else 'value'}{unit}."
    if kind == "value_error":
        reason = told.removeprefix("Value error, ")
        return f"{place} is invalid: {reason}." if location else f"{reason}."
    _, should, expected = told.partition(" should ")
    told = f"but{should}{expected}" if should else told
    return f"{place} is {_value_text(finding['input'])}, {told}{unit}."


def _value_text(value: Any) -> str:
    """Return a value as text of at most 60 characters; YAML references may make it huge."""
    value = value.value if isinstance(value, enum.Enum) else value
    try:
        return shortened(repr(value) if isinstance(value, str) else _SHORT.repr(value), 60)
    except ValueError:  # a number with thousands of digits
        return "a number that is too long"


_SHORT = reprlib.Repr()
_SHORT.maxlevel = 3
_SHORT.maxother = 100


def did_you_mean(wrong: str, valid: Iterable[str]) -> str:
    """Return the end of a sentence: the nearest valid name and, if there are few, all of them."""
    names = sorted(valid)
    hint = nearest(wrong, names)
    if len(names) > _MOST_LISTED:
        return f"{hint} `tactile-hand show paper` lists all {len(names)}."
    return f"{hint} Valid are: {', '.join(names)}." if names else hint


def _walk(
    model: Any, location: Iterable[int | str]
) -> tuple[Mapping[str, FieldInfo], FieldInfo | None]:
    """Follow a location and return all fields in its place and its own; skip unknown steps."""
    annotation, fields, field = model, dict[str, FieldInfo](), None
    for part in location:
        if isinstance(part, int):
            annotation, fields = element_type(annotation), {}
            continue
        is_model = isinstance(annotation, type) and issubclass(annotation, BaseModel)
        fields = annotation.model_fields if is_model else {}
        if part in fields:
            field = fields[part]
            annotation = field.annotation
    return fields, field


def allowed(annotation: Any, field: FieldInfo) -> str:
    """Describe what a field accepts besides its type, such as ``>= 0 and <= 1 N``."""
    if choices := choices_of(element_type(annotation)):
        return "one of " + ", ".join(choices)
    bounds = ((phrase, bound_of(field, name)) for name, phrase in _LIMITS.items())
    limits = [phrase.format(bound) for phrase, bound in bounds if bound is not None]
    return " ".join(filter(None, [" and ".join(limits), unit_of(field)]))


_LIMITS = {
    "ge": ">= {}",
    "gt": "> {}",
    "le": "<= {}",
    "lt": "< {}",
    "min_length": "with at least {} items",
    "max_length": "with at most {} items",
}


SEQUENCES = (list, tuple)


def unit_of(field: FieldInfo) -> str:
    """Return the unit declared with `param`, empty if none."""
    return str(_extra(field).get("unit", ""))


def is_live(field: FieldInfo) -> bool:
    """Return whether the field was declared with ``live=True``."""
    return bool(_extra(field).get("live", False))


def _extra(field: FieldInfo) -> Mapping[str, Any]:
    extra = field.json_schema_extra
    return extra if isinstance(extra, Mapping) else {}


def is_sequence(annotation: Any) -> bool:
    """Return whether a type is a list or tuple of something."""
    return typing.get_origin(annotation) in SEQUENCES


def element_type(annotation: Any) -> Any:
    """Return the item type of a list or tuple type without its constraints, else the type."""
    if not is_sequence(annotation):
        return annotation
    item = typing.get_args(annotation)[0]
    return typing.get_args(item)[0] if typing.get_origin(item) is typing.Annotated else item


def choices_of(annotation: Any) -> list[str]:
    """Return the accepted names of a Literal or Enum type, empty for other types."""
    if typing.get_origin(annotation) is typing.Literal:
        return [str(choice) for choice in typing.get_args(annotation)]
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return [str(member.value) for member in annotation]
    return []


def bound_of(field: FieldInfo, name: str) -> Any:
    """Return a constraint (``ge``, ``gt``, ``le``, ``lt``, ...) of a field, None if not set."""
    bounds = (getattr(item, name, None) for item in field.metadata)
    return next((bound for bound in bounds if bound is not None), None)
