# SPDX-License-Identifier: Apache-2.0
"""Read YAML files as plain data, with one-sentence errors."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from tactile_hand_ros.config.explanation import after_source, did_you_mean
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.errors import ConfigurationError

LARGEST = 2**20
"""Maximum size of a text file [B]."""

LARGEST_YAML = 2**17
"""Maximum size of a YAML file [B]; the parser reads about 50 kB/s."""

SUFFIXES = (".yaml", ".yml")


def find_file(kind: str, name: str) -> Path:
    """Return the YAML file of a ``hand`` or ``scenario``, by name in the package or by path.

    Raises:
        ConfigurationError: If neither a file nor one of that name exists.
    """
    path = Path(os.path.expanduser(name))  # unchanged if there is no such user
    folder = config_directory() / f"{kind}s"
    known = sorted(file.stem for file in folder.glob("*.yaml"))
    if path.suffix in SUFFIXES:
        if path.is_file():
            return path
        raise ConfigurationError(
            f"{kind} file '{path}' does not exist; give a YAML file or one of: {', '.join(known)}"
        )
    if name in known:
        return folder / f"{name}.yaml"
    raise ConfigurationError(
        f"no {kind} is called '{name}'{did_you_mean(name, known)} Give one of them or the path of "
        "a YAML file"
    )


def read_text(path: str | Path, largest: int = LARGEST) -> str:
    """Read a text file.

    Raises:
        ConfigurationError: If it cannot be read, is too large or not UTF-8.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(largest + 1)
        if len(data) > largest:
            raise ValueError(f"it is larger than {largest} bytes, the maximum that is read")
        return data.decode("utf-8")
    except (OSError, ValueError) as error:  # also of an invalid file name, or of other than UTF-8
        name, reason = str(path).encode(errors="backslashreplace").decode(), str(error)
        reason = str(error.strerror) if isinstance(error, OSError) else reason
        raise ConfigurationError(f"{name}: cannot be read: {reason}.") from None


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file as plain data; an empty file is an empty mapping.

    Raises:
        ConfigurationError: If the file cannot be read, is too large or is not YAML.
    """
    return parse_yaml(read_text(path, LARGEST_YAML), str(path))


class _Loader(yaml.SafeLoader):
    """Rejects a key that is given twice; YAML would keep the last value."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Return a mapping as plain data."""
        seen: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                problem = f"the key '{key.value}' is given twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def parse_yaml(text: str, source: str = "") -> Any:
    """Parse YAML text as plain data; empty text is an empty mapping.

    Raises:
        ConfigurationError: If the text is not YAML.
    """
    try:
        data = yaml.load(text, _Loader)
    except Exception as error:  # of any kind: PyYAML converts values without checks
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else "this file"
        problem = getattr(error, "problem", None) or error
        raise ConfigurationError(
            f"{after_source(source)}{place} is not valid YAML: {problem}."
        ) from None
    return {} if data is None else data


def parse_changes(changes: Sequence[str]) -> dict[str, Any]:
    """Read ``key=value`` texts of a command line; values are YAML.

    Raises:
        ConfigurationError: If key or value is missing, or the value is not YAML.
    """
    found: dict[str, Any] = {}
    for change in changes:
        key, _, value = change.partition("=")
        if not key or not value.strip():
            raise ConfigurationError(
                f"--set got '{change}', expected key=value such as plant.rate=250"
            )
        found[key] = parse_yaml(value, f"--set {key}")
    return found


def yaml_text(data: Any) -> str:
    """Return plain data as YAML that `parse_yaml` reads back."""
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)
    return text
