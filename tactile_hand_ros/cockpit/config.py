# SPDX-License-Identifier: Apache-2.0
"""Configuration of the cockpit."""

from __future__ import annotations

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.simulation.plant_config import ObjectConfig

LINK = "cockpit: "
"""What stands before the link in the output of the node."""


class CockpitConfig(Config):
    """Configuration of the cockpit."""

    name: str = param("live", "title of the page")
    hand: str = param("paper", "hand by name or YAML file")
    object: ObjectConfig = ObjectConfig()
    port: int = param(0, "port, 0 for any free one", ge=0, le=65535)
    drivers: bool = param(
        False, "receive joints and touch from the drivers of a real hand, which send no batches"
    )
    bag: str = param("", "bag that is being recorded, to save a part of it")
