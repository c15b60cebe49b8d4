# SPDX-License-Identifier: Apache-2.0
"""A measured quantity, its target, and its row in the table."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.report.tables import number

COLUMNS = ("measurement", "median", "1 to 99 %", "target", "")


@dataclass(frozen=True)
class Measurement:
    """Samples of one quantity.

    Attributes:
        name: Name of the quantity.
        unit: Its unit.
        samples: The samples.
        maximum: Target, upper bound of the median; NaN for none.
        minimum: Target, lower bound of the median; NaN for none.
    """

    name: str
    unit: str
    samples: Sequence[float] | NDArray[np.float64]
    maximum: float = math.nan
    minimum: float = math.nan

    @property
    def marks(self) -> tuple[float, float, float]:
        """Median, 1st and 99th percentile."""
        low, median, high = np.percentile(self.samples, (1.0, 50.0, 99.0)).tolist()
        return median, low, high

    @property
    def verdict(self) -> str:
        """``pass`` or ``fail``; empty without a target."""
        if math.isnan(self.maximum) and math.isnan(self.minimum):
            return ""
        median = self.marks[0]
        fails = median > self.maximum or median < self.minimum or math.isnan(median)
        return "fail" if fails else "pass"

    @property
    def row(self) -> list[str]:
        """Cells of the table, columns as in `COLUMNS`."""
        median, low, high = self.marks
        spread = f"{number(low)} to {number(high)}" if len(self.samples) > 1 else ""
        target = "" if math.isnan(self.maximum) else f"<= {self.maximum:g}"
        target = target if math.isnan(self.minimum) else f">= {self.minimum:g}"
        return [self.name, number(median, self.unit), spread, target, self.verdict]


def to_json(results: Sequence[Measurement]) -> dict[str, Any]:
    """Return the results and a description of the machine as plain data."""
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "versions": versions()}
    rows = []
    for result in results:
        median, low, high = result.marks
        row: dict[str, Any] = {"name": result.name, "unit": result.unit}
        row |= {"count": len(result.samples), "median": median, "p1": low, "p99": high}
        rows.append({**row, "verdict": result.verdict})
    return {"machine": machine, "results": rows}
