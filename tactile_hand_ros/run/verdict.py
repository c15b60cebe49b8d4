# SPDX-License-Identifier: Apache-2.0
"""How a run is judged: by what it was asked to reach, in the same words everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tactile_hand_ros.scenario.scenario import GoalConfig

DROPPED = "object dropped"
REACHED = "goal reached"
NOT_REACHED = "goal not reached"
STEERED = "finished"
"""Of a run that a user steered and ended: no goal says where it should have come to."""


@dataclass(frozen=True)
class Judged:
    """One number that the goal of a scenario limits.

    Attributes:
        name: What it is.
        value: How large it is, None where it is not known.
        limit: The largest that is good.
        unit: Of both.
    """

    name: str
    value: float | None
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether it is known and inside its limit."""
        return self.value is not None and self.value <= self.limit


def judged(metrics: Mapping[str, Any], goal: GoalConfig) -> list[Judged]:
    """Return what the goal limits; slip only where the metrics know it.

    Args:
        metrics: Fields of `Metrics` by name; what is not known may be NaN or None.
        goal: The scenario's goal.
    """
    position, rotation = metrics["final_position_error_m"], metrics["final_rotation_error_rad"]
    found = [
        Judged("final position error", position, goal.position_error, "m"),
        Judged("final rotation error", rotation, goal.rotation_error, "rad"),
    ]
    slid = metrics.get("max_slip_distance_m")
    if slid is not None and not math.isnan(slid):  # unknown for a real hand
        found.append(Judged("longest slip", slid, goal.slip_distance, "m"))
    return found


def reached(metrics: Mapping[str, Any], goal: GoalConfig) -> bool:
    """Return whether a run reached its goal: the object is held and everything inside its limit.

    Args:
        metrics: Fields of `Metrics` by name; what is not known may be NaN or None.
        goal: The scenario's goal.
    """
    dropped = metrics.get("dropped_at_s")
    held = dropped is None or math.isnan(dropped)
    return held and all(each.passed for each in judged(metrics, goal))


def headline(metrics: Mapping[str, Any], *, steered: bool = False) -> str:
    """Return what became of a run in a few words, empty where nothing judges it.

    Args:
        metrics: `Metrics.to_dict()`.
        steered: Whether a user steered it.
    """
    dropped = metrics.get("dropped_at_s")
    if dropped is not None:
        return f"{DROPPED} at {dropped:.3f} s"
    if steered:
        return STEERED
    reached = metrics.get("goal_reached")
    return "" if reached is None else REACHED if reached else NOT_REACHED
