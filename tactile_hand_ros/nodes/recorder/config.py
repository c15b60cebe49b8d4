# SPDX-License-Identifier: Apache-2.0
"""Configuration of the recorder."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from tactile_hand_ros.bag.selection import TopicSelection
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import ConfigurationError

Compression = Literal["none", "lz4", "zstd"]


class RecorderConfig(Config):
    """Configuration of the recorder."""

    output: str = param(
        ...,
        "rosbag2 folder to create; it must not exist, its parents may",
        min_length=1,
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
