# SPDX-License-Identifier: Apache-2.0
"""Runs of studies in tests, importable by their workers."""

import os
import signal
from typing import Any

from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.sweep.engine import Point


def product(point: Point) -> dict[str, Any]:
    """Return x times y, with the seed's last bit as the outcome; fail if x is above 0.9."""
    x, y = point.values["x"], point.values["y"]
    if x > 0.9:
        raise DivergedError(f"x is {x:.3f}")
    return {"xy_m": x * y, "outcome": "reached" if point.seed % 2 else "missed"}


def deadly(point: Point) -> dict[str, Any]:
    """Kill the process at run 3."""
    if point.index == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return product(point)
