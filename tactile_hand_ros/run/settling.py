# SPDX-License-Identifier: Apache-2.0
"""How long the hand needs after a disturbance until the object is back at its target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario

BACK = 0.001
"""Position error below which an object counts as back [m]."""


@dataclass(frozen=True)
class Settling:
    """What became of the pose after a disturbance began.

    Attributes:
        start: When it began, s.
        largest: Largest error of the contact centroid until the next event or the end, m.
        time: From the start until the error stays below `BACK`, s; infinite where it does not.
        last: Error at the next event or the end, m.
    """

    start: float
    largest: float
    time: float
    last: float

    def to_dict(self) -> dict[str, float]:
        """Return plain data with units in the names."""
        return {
            "start_s": self.start,
            "largest_error_m": self.largest,
            "recovery_time_s": self.time,
            "last_error_m": self.last,
        }


def recoveries(record: Record, scenario: Scenario) -> list[Settling]:
    """Return the recovery from each disturbance and each change of friction of a run.

    Args:
        record: The run; the pose is that which the hand believes, and unknown while it holds.
        scenario: What was run.
    """
    plant = scenario.plant
    events = {d.start for d in plant.disturbances} | {c.start for c in plant.friction_changes}
    starts = sorted(event for event in events if 0.0 < event < scenario.duration)
    errors = np.linalg.norm(record.desired_position - record.auxiliary_position, axis=1)
    return [
        _recovery(record, errors, *span) for span in pairwise([*starts, scenario.duration + 1.0])
    ]


def _recovery(record: Record, errors: NDArray[np.float64], start: float, end: float) -> Settling:
    rows = (record.times >= start) & (record.times < end)
    times, own = record.times[rows], errors[rows]
    if not np.isfinite(own).any():
        return Settling(start, math.nan, math.inf, math.nan)
    away = np.flatnonzero(~(own < BACK))  # unknown is away, too
    if not len(away):
        back = 0.0
    elif away[-1] + 1 == len(own):
        back = math.inf
    else:
        back = float(times[away[-1] + 1] - start)
    return Settling(start, float(np.nanmax(own)), back, float(own[-1]))
