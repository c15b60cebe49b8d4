# SPDX-License-Identifier: Apache-2.0
"""Configuration of the recorder, and the selection of topics by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from pydantic import field_validator

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import ConfigurationError

Compression = Literal["none", "lz4", "zstd"]


class TopicSelection:
    """A selection of topics by regular expressions on their names."""

    def __init__(self, include: Sequence[str], exclude: Sequence[str] = ()) -> None:
        """Compile the patterns: one `include` and no `exclude` must match the whole name.

        Raises:
            ConfigurationError: If a pattern is invalid.
        """
        try:
            self._include = [re.compile(pattern) for pattern in include]
            self._exclude = [re.compile(pattern) for pattern in exclude]
        except re.error as error:
            text = f"'{error.pattern!s}' is not a valid regular expression: {error}."
            raise ConfigurationError(text) from None

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is selected, by its full name; hidden topics never are."""
        is_hidden = any(part.startswith("_") for part in topic.split("/"))
        if is_hidden or any(pattern.fullmatch(topic) for pattern in self._exclude):
            return False
        return any(pattern.fullmatch(topic) for pattern in self._include)


class RecorderConfig(Config):
    """Configuration of the recorder."""

    output: str = param(
        ..., "rosbag2 folder to create; it must not exist, its parents may", min_length=1
    )
    topics: list[str] = param(
        [".*"], "regular expressions; a topic is recorded if one matches its whole name"
    )
    exclude: list[str] = param(
        [], "regular expressions; a topic is not recorded if one matches its whole name"
    )
    compression: Compression = param("zstd", "compression of the chunks of the MCAP file")
    scenario: str = param(
        "", "scenario of the run as YAML text, stored in the bag with the versions in use"
    )

    @field_validator("topics", "exclude")
    @classmethod
    def _compile(cls, patterns: list[str]) -> list[str]:
        try:
            TopicSelection(patterns)
        except ConfigurationError as error:
            raise ValueError(str(error)) from None
        return patterns
