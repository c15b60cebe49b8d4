# SPDX-License-Identifier: Apache-2.0
"""Hands to test with: those of the benchmarks, any number of fingers and of joints a finger."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from bench.hands import LINK, posture_for, prism_grasp, write_hand

__all__ = ["LINK", "posture_for", "prism_grasp", "tip_rotations", "write_hand"]


def tip_rotations(description: str, tips: Sequence[str], theta: NDArray) -> NDArray:
    """Return the orientations of tip links by Pinocchio alone, shape (k, 3, 3)."""
    model = pin.buildModelFromXML(description)
    data = model.createData()
    pin.framesForwardKinematics(model, data, theta)
    return np.array([data.oMf[model.getFrameId(tip)].rotation for tip in tips])
