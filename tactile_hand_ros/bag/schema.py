# SPDX-License-Identifier: Apache-2.0
"""Message definitions as text, the schema of a channel.

The text is the ``.msg`` file of the type, followed by the files of all types that it uses, depth
first and in alphabetical order within a file. Each follows a line of 80 ``=`` and its name.

Source: ``LocalMessageDefinitionSource`` of rosbag2_cpp (Jazzy). The result is identical byte for
byte, quirks included.
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
# Like std::regex: ASCII; no MULTILINE, so "^" is the start of the text; "\s" is a C locale blank.
_FIELD = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+", re.ASCII)
_TYPE_NAME = re.compile(r"([a-zA-Z]\w*)/(?:msg/)?([a-zA-Z]\w*)", re.ASCII)


@dataclass(frozen=True)
class MessageDefinition:
    """Schema of a type: encoding and text."""

    encoding: str
    text: str


@functools.cache
def message_definition(type_name: str) -> MessageDefinition:
    """Return the definition of an installed message type such as ``std_msgs/msg/String``.

    Raises:
        BagError: If the package or the type is not installed.
    """
    try:
        return MessageDefinition("ros2msg", _collect(type_name, set()))
    except (PackageNotFoundError, ValueError, OSError) as error:  # OSError: or no index
        raise BagError(
            f"No definition of the message type '{type_name}' was found ({error}); expected "
            "share/<package>/msg/<Type>.msg on AMENT_PREFIX_PATH; install or source its package."
        ) from None


def _collect(type_name: str, seen: set[str]) -> str:
    match = _TYPE_NAME.fullmatch(type_name)
    if not match:
        raise ValueError(f"'{type_name}' is not a type name")
    package, name = match.groups()
    text = (
        (Path(get_package_share_directory(package)) / "msg" / f"{name}.msg").read_bytes().decode()
    )
    names = set(_FIELD.findall(text)) - _PRIMITIVES
    for used in sorted(name if "/" in name else f"{package}/{name}" for name in names):
        if used not in seen:
            seen.add(used)
            text += f"\n{_SEPARATOR}MSG: {used}\n" + _collect(used, seen)
    return text
