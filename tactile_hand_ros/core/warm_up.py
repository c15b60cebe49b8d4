# SPDX-License-Identifier: Apache-2.0
"""Compile what `compiled` marks, so that no run has to wait: ``python -m ...core.warm_up``."""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.core.plant import Plant
from tactile_hand_ros.core.plant_config import PlantConfig


def warm_up() -> None:
    """Take one step with contacts that stick and one with contacts that slip."""
    plant = Plant(PlantConfig())
    plant.advance(np.zeros(plant.hand.joints))
    plant.friction[:] = 0.0
    plant.advance(np.full(plant.hand.joints, 0.1))


if __name__ == "__main__":
    warm_up()
