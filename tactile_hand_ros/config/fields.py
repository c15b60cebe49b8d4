# SPDX-License-Identifier: Apache-2.0
"""What a field of a configuration declares: its type, unit and bounds."""

from __future__ import annotations

import enum
import typing
from collections.abc import Mapping
from typing import Any

from pydantic.fields import FieldInfo

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


def element_type(annotation: Any) -> Any:
    """Return the item type of a list or tuple type without its constraints, else the type."""
    if typing.get_origin(annotation) not in SEQUENCES:
        return annotation
    item = typing.get_args(annotation)[0]
    return typing.get_args(item)[0] if typing.get_origin(item) is typing.Annotated else item


def is_sequence(annotation: Any) -> bool:
    """Return whether a type is a list or tuple of something."""
    return typing.get_origin(annotation) in SEQUENCES


def choices_of(annotation: Any) -> list[str]:
    """Return the accepted names of a Literal or Enum type, empty for other types."""
    if typing.get_origin(annotation) is typing.Literal:
        return [str(choice) for choice in typing.get_args(annotation)]
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return [str(member.value) for member in annotation]
    return []


def bound_of(field: FieldInfo, name: str) -> Any:
    """Return a constraint (``ge``, ``gt``, ``le``, ``lt``, ...) of a field, None if not set."""
    for item in field.metadata:
        bound = getattr(item, name, None)
        if bound is not None:
            return bound
    return None
