# SPDX-License-Identifier: Apache-2.0
"""Text files of unknown origin: bounded in size, nesting and what their references expand to."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

import yaml

from tactile_hand_ros.errors import ConfigurationError

LARGEST = 2**20
"""Largest text file that is read [B]."""

DEEPEST = 50
"""Deepest nesting of lists and mappings in YAML."""

MOST_VALUES = 20_000
"""Most values in YAML, with those that references repeat counted again."""

# libyaml is fast and does not recurse; PyYAML can be built without it.
_Events = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_text(path: str | Path, largest: int = LARGEST) -> str:
    """Read a text file.

    Raises:
        ConfigurationError: If it cannot be read, is not a regular file, is too large or not UTF-8.
    """
    try:
        path = Path(path)
        if not stat.S_ISREG(path.stat().st_mode):  # a device or pipe need not end
            kind = "a folder" if path.is_dir() else "a device, pipe or socket"
            raise _unreadable(path, f"it is {kind}, expected a file")
        with path.open("rb") as file:
            data = file.read(largest + 1)
        if len(data) > largest:
            raise _unreadable(path, f"it is larger than {largest} bytes, the most that is read")
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _unreadable(path, f"not UTF-8 text, see byte {error.start}") from None
    except OSError as error:
        raise _unreadable(path, str(error.strerror)) from None
    except ValueError as error:  # a name that no file can have
        raise _unreadable(path, str(error)) from None


def _unreadable(path: str | Path, reason: str) -> ConfigurationError:
    name = str(path).encode(errors="backslashreplace").decode()
    return ConfigurationError(f"{name}: cannot be read: {reason}.", source=name)


def check_yaml(text: str, most: int = MOST_VALUES) -> None:
    """Refuse YAML text that is small but expands to much, before anything is built from it.

    Raises:
        yaml.YAMLError: If it is not YAML, is nested too deeply, holds too many values, or refers to
            what is not complete.
    """
    sizes = [0]  # values in each open collection
    anchors: list[str | None] = []  # of each open collection
    known: dict[str, int] = {}  # values behind each anchor
    for event in yaml.parse(text, Loader=_Events):
        if isinstance(event, yaml.CollectionStartEvent):
            sizes.append(1)
            anchors.append(event.anchor)
            if len(anchors) > DEEPEST:
                raise _refusal(event, f"it is nested more than {DEEPEST} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            size, anchor = sizes.pop(), anchors.pop()
            known |= {anchor: size} if anchor else {}
            sizes[-1] += size
        elif isinstance(event, yaml.ScalarEvent):
            known |= {event.anchor: 1} if event.anchor else {}
            sizes[-1] += 1
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in anchors:
                raise _refusal(event, f"'*{event.anchor}' refers to what it is part of")
            sizes[-1] += known.get(str(event.anchor), 1)
        if sizes[-1] > most:
            raise _refusal(event, f"it holds more than {most} values")


def _refusal(event: yaml.Event, problem: str) -> yaml.MarkedYAMLError:
    mark: Any = event.start_mark
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
