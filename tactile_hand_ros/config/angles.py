# SPDX-License-Identifier: Apache-2.0
"""Angles in radians, and a question where they look like degrees."""

from __future__ import annotations

import math
from collections.abc import Sequence

HALF_TURN = math.pi
FULL_TURN = 2.0 * math.pi
_ROUNDING = 1e-3  # rad; a half turn may be written with few digits


def check_radians(angles: Sequence[float], most: float = FULL_TURN) -> None:
    """Refuse angles of which no user means as many radians.

    Args:
        angles: Angles, or a rotation vector, in rad.
        most: Largest sensible angle, rad.

    Raises:
        ValueError: With the same values read as degrees.
    """
    if max((abs(angle) for angle in angles), default=0.0) <= most + _ROUNDING:
        return
    given, meant = _listed(angles), _listed([math.radians(angle) for angle in angles])
    turn = "half a turn" if most == HALF_TURN else "a full turn"
    raise ValueError(f"{given} goes beyond {turn}; angles are in rad: {meant} if these are degrees")


def _listed(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in values) + "]"
