# SPDX-License-Identifier: Apache-2.0
"""YAML as plain data: numbers as in YAML 1.2, no key twice, and one sentence for what is wrong."""

from __future__ import annotations

import copy
import functools
import re
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from tactile_hand_ros.config.explanation import after_source, shortened
from tactile_hand_ros.config.untrusted import check_yaml, read_text
from tactile_hand_ros.errors import ConfigurationError

_LARGEST = 2**17  # bytes of a YAML file; its parser reads some 50 kB a second


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
        message = f"{after_source(source)}{place} is not valid YAML: {problem}."
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
            problem = f"{shortened(node.value)} is no {kind} ({error})"
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
