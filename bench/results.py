# SPDX-License-Identifier: Apache-2.0
"""What a measurement gives: samples summed up, goals, and ratios to what was measured beside it."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.run.metrics import json_ready

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Goal:
    """A bound on one statistic of a measurement.

    Attributes:
        statistic: ``median``, ``p99``, ``p999`` or ``largest``.
        at_most: Upper bound; None for none.
        at_least: Lower bound; None for none.
    """

    statistic: str
    at_most: float | None = None
    at_least: float | None = None

    def met(self, result: Result) -> bool:
        """Return whether a result meets it."""
        value: float = getattr(result, self.statistic)
        over = self.at_most is None or value <= self.at_most
        return over and (self.at_least is None or value >= self.at_least)


@dataclass(frozen=True)
class Result:
    """Samples of one quantity, summed up.

    Attributes:
        name: What was measured.
        unit: Its unit.
        count: Number of samples.
        median: Median.
        p99: 99th percentile.
        p999: 99.9th percentile; of fewer than a thousand samples little more than the largest.
        largest: Largest sample.
        goals: What is asked of it.
        beside: Name of what was measured beside it, in the same run and turn by turn.
        ratio: Its median in units of that one's; NaN if it stands alone.
        section: Title of the section that it belongs to.
    """

    name: str
    unit: str
    count: int
    median: float
    p99: float
    p999: float
    largest: float
    goals: tuple[Goal, ...] = ()
    beside: str = ""
    ratio: float = math.nan
    section: str = ""

    @classmethod
    def of(cls, name: str, unit: str, samples: Sequence[float] | Array, *goals: Goal) -> Result:
        """Sum up samples."""
        marks = np.percentile(samples, [50.0, 99.0, 99.9, 100.0])
        median, p99, p999, largest = (float(mark) for mark in marks)
        return cls(name, unit, len(samples), median, p99, p999, largest, goals)

    def against(self, other: Result) -> Result:
        """Return the result with its ratio to another."""
        return replace(self, beside=other.name, ratio=self.median / other.median)

    @property
    def met(self) -> bool | None:
        """Whether all goals are met; None without goals."""
        return all(goal.met(self) for goal in self.goals) if self.goals else None


def to_json(results: Sequence[Result]) -> dict[str, Any]:
    """Return results and machine as plain data."""
    content: dict[str, Any] = json_ready(
        {
            "machine": {
                "cpus": os.cpu_count(),
                "system": platform.platform(),
                "versions": versions(),
            },
            "results": [{**asdict(r), "met": r.met} for r in results],
        }
    )
    return content
