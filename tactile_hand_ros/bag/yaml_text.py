# SPDX-License-Identifier: Apache-2.0
"""YAML text as in the metadata of rosbag2: written in the layout of yaml-cpp, read with care."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml

_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.+-]*")
_RESERVED = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the fast one, where PyYAML has it


def load(text: str) -> Any:
    """Return what YAML text of unknown origin says.

    Raises:
        yaml.YAMLError: If it is not YAML, or small text that expands to much.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise yaml.YAMLError(f"a value is not what it seems ({error})") from None


def dump(value: Any) -> str:
    """Return mappings, sequences, texts, integers, booleans and None as YAML text.

    Lines are indented by two spaces, sequences inside mappings too, and the text ends without a
    newline, as yaml-cpp writes it. An empty mapping is None there.
    """
    if isinstance(value, Mapping | list | tuple) and value:
        return "\n".join(_lines(value))
    return "[]" if isinstance(value, list | tuple) else _scalar(value)


def _lines(value: Mapping[str, Any] | Sequence[Any]) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _entry(_scalar(key), item)
        return
    for item in value:
        first, *rest = dump(item).split("\n")
        yield f"- {first}"
        yield from (f"  {line}" for line in rest)


def _entry(key: str, item: Any) -> Iterator[str]:
    if isinstance(item, list | tuple) or (isinstance(item, Mapping) and item):
        yield f"{key}:"
        yield from (f"  {line}" for line in dump(item).split("\n"))
    else:
        yield f"{key}: {dump(item)}"


def _scalar(value: Any) -> str:
    if value is None or (isinstance(value, Mapping) and not value):
        return "~"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    text = str(value)
    if _PLAIN.fullmatch(text) and text.lower() not in _RESERVED:
        return text
    return f'"{"".join(_escaped(character) for character in text)}"'


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\U{ord(character):08x}"
