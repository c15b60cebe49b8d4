# SPDX-License-Identifier: Apache-2.0
"""Which engine simulates the plant."""

from __future__ import annotations

from tactile_hand_ros.simulation.mujoco_plant import MujocoPlant
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import PlantConfig


def make_plant(config: PlantConfig) -> Plant:
    """Return a plant with the physics engine of its parameters; see `Plant` for its errors.

    Raises:
        MissingLibraryError: If that engine is not installed.
    """
    return MujocoPlant(config) if config.engine == "mujoco" else Plant(config)
