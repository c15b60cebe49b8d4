# SPDX-License-Identifier: Apache-2.0
"""Message definitions as text, the schema of a channel.

The text is the ``.msg`` file of the type followed by the files of all types it uses, depth first
and in alphabetical order within a file, each under a line of 80 ``=`` and its name. Types that
have only an ``.idl`` file are written as IDL.

Source: ``LocalMessageDefinitionSource`` of rosbag2_cpp (Jazzy), whose result this equals byte
for byte, quirks included.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from tactile_hand_ros.errors import BagError

_SEPARATOR = "=" * 80 + "\n"
_PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string"}
_PRIMITIVES |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
# ASCII and no MULTILINE, as std::regex: "^" is the start of the text, "\s" the C locale's blanks.
_MSG_FIELD = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+", re.ASCII)
_IDL_INCLUDE = re.compile(r'(?:^|\n)#include\s+(?:"|<)([a-zA-Z0-9_/]+)\.idl(?:"|>)', re.ASCII)
_TYPE_NAME = re.compile(r"([a-zA-Z]\w*)/(?:([a-zA-Z]\w*)/)?([a-zA-Z]\w*)", re.ASCII)


@dataclass(frozen=True)
class MessageDefinition:
    """Schema of a type: how it is written and the text."""

    encoding: str  # ros2msg or ros2idl
    text: str


class _DefinitionNotFoundError(Exception):
    pass


@functools.cache
def message_definition(type_name: str) -> MessageDefinition:
    """Return the definition of an installed message type.

    Args:
        type_name: Full name, e.g. ``sensor_msgs/msg/JointState``.

    Raises:
        BagError: If the package or the type is not installed.
    """
    try:
        return MessageDefinition("ros2msg", _collect(type_name, "msg", set()))
    except _DefinitionNotFoundError:
        pass
    try:
        text = _delimiter(type_name, "idl") + _collect(type_name, "idl", set())
        return MessageDefinition("ros2idl", text)
    except _DefinitionNotFoundError as error:
        raise BagError(
            f"No definition of the message type '{type_name}' was found ({error}), expected "
            "share/<package>/msg/<Type>.msg on AMENT_PREFIX_PATH; install or source its package."
        ) from None


def _collect(type_name: str, kind: str, seen: set[str]) -> str:
    package, text = _read(type_name, kind)
    for used in _used_types(text, kind, package):
        if used not in seen:
            seen.add(used)
            text += "\n" + _delimiter(used, kind) + _collect(used, kind, seen)
    return text


def _delimiter(type_name: str, kind: str) -> str:
    return f"{_SEPARATOR}{kind.upper()}: {type_name}\n"


def _used_types(text: str, kind: str, package: str) -> list[str]:
    if kind == "idl":
        return sorted(set(_IDL_INCLUDE.findall(text)))
    names = set(_MSG_FIELD.findall(text)) - _PRIMITIVES
    return sorted(name if "/" in name else f"{package}/{name}" for name in names)


@functools.cache
def _read(type_name: str, kind: str) -> tuple[str, str]:
    """Return the package of a type and the unchanged text of its file."""
    match = _TYPE_NAME.fullmatch(type_name)
    if not match:
        raise _DefinitionNotFoundError(f"'{type_name}' is not a type name")
    package, folder, name = match[1], match[2] or "msg", match[3]
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError, OSError):  # OSError: no AMENT_PREFIX_PATH
        raise _DefinitionNotFoundError(f"no package '{package}'") from None
    path = share / folder / f"{name}.{kind}"
    try:
        return package, path.read_bytes().decode()
    except FileNotFoundError:
        raise _DefinitionNotFoundError(f"no file {path}") from None
