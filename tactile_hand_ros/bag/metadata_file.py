# SPDX-License-Identifier: Apache-2.0
"""Reading of ``metadata.yaml`` files that others wrote, perhaps to do harm."""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from tactile_hand_ros.bag.metadata import FILE_NAME
from tactile_hand_ros.bag.yaml_text import load
from tactile_hand_ros.config.plain_yaml import read_text
from tactile_hand_ros.errors import BagError, ConfigurationError

_MOST = 2**63 - 1
_TOP = "rosbag2_bagfile_information"
_NUMBERS = (
    ("message_count",),
    ("duration", "nanoseconds"),
    ("starting_time", "nanoseconds_since_epoch"),
)


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says, without its outermost key.

    Raises:
        BagError: If it is missing, not a regular file, too large, nested too deeply or not YAML.
    """
    path = folder / FILE_NAME
    try:
        tree = load(read_text(path))
    except ConfigurationError as error:
        raise BagError(str(error)) from None
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        place = f", line {mark.line + 1}" if mark else ""
        raise BagError(f"{path}{place}: {problem or error}") from None
    if not isinstance(tree, dict) or not isinstance(tree.get(_TOP), dict):
        raise BagError(f"{path}: there is no mapping '{_TOP}'")
    return dict(tree[_TOP])


def check_metadata(folder: Path) -> None:
    """Check the values of ``metadata.yaml`` that readers compute with, and the files it names.

    Raises:
        BagError: If one is not what it should be; says which.
    """
    tree = read_metadata(folder)
    path = folder / FILE_NAME
    for keys in _NUMBERS:
        _check_number(_at(tree, keys), ".".join(keys), path)
    for place, topic in _topics(tree, path):
        _check_number(topic.get("message_count"), f"{place}.message_count", path)
        for key in ("name", "type"):
            value = _at(topic, ("topic_metadata", key))
            if not isinstance(value, str):
                raise _wrong(f"{place}.topic_metadata.{key}", value, "a text", path)
    custom = tree.get("custom_data") or {}
    if not isinstance(custom, dict) or not all(isinstance(text, str) for text in custom.values()):
        raise _wrong("custom_data", custom, "texts by name", path)
    for file in _files(tree, folder, path):
        check_regular(file)


def check_regular(file: Path) -> None:
    """Refuse what would block or never end when it is read.

    Raises:
        BagError: If it is there and not a regular file.
    """
    try:
        kind = file.stat().st_mode
    except OSError:
        return  # readers say what is missing
    if not stat.S_ISREG(kind):
        raise BagError(f"{file} is a folder, device, pipe or socket, expected a file of a bag.")


def _topics(tree: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    topics = tree.get("topics_with_message_count")
    if not isinstance(topics, list) or not all(isinstance(topic, dict) for topic in topics):
        raise _wrong("topics_with_message_count", topics, "a list of mappings", path)
    for number, topic in enumerate(topics):
        yield f"topics_with_message_count[{number}]", topic


def _files(tree: Mapping[str, Any], folder: Path, path: Path) -> list[Path]:
    """Return the files that readers open: those of these names in the folder itself."""
    names = tree.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise _wrong("relative_file_paths", names, "a list of file names", path)
    for name in names:
        parts = Path(name).parts
        if not parts or ".." in parts or Path(name).is_absolute() or "\0" in name:
            raise _wrong("relative_file_paths", name, "names of files in the bag's folder", path)
    return [folder / Path(name).name for name in names]


def _at(tree: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    value: Any = tree
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _check_number(value: Any, place: str, path: Path) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise _wrong(place, value, "a whole number >= 0 of at most 63 bits", path)


def _wrong(place: str, value: Any, expected: str, path: Path) -> BagError:
    return BagError(f"{path}: {place} is {_short(value)}, expected {expected}")


def _short(value: Any) -> str:
    if isinstance(value, int) and value.bit_length() > 200:
        return f"a number of {value.bit_length()} bits"  # Python refuses to print the longest
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
