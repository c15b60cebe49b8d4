# SPDX-License-Identifier: Apache-2.0
"""The table of a sweep, column by column, and what it shows: fractions, medians, sensitivities."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.metrics import measures
from tactile_hand_ros.sweep.space import Choice, Parameter
from tactile_hand_ros.sweep.statistics import fraction_of, median_interval
from tactile_hand_ros.sweep.sweep import SCENARIO, Sweep
from tactile_hand_ros.sweep.table import OUTCOMES, REACHED, read_column

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Effect:
    """How much a parameter moves a metric.

    Attributes:
        parameter: Its path.
        metric: Its column.
        value: Spearman's rank correlation.
        low: Lower end of the 95 % interval.
        high: Upper end.
    """

    parameter: str
    metric: str
    value: float
    low: float
    high: float


class Results:
    """The finished runs of one scenario of a sweep, or of all.

    Attributes:
        sweep: What was asked.
        scenario: Name of the scenario, empty for all.
    """

    def __init__(self, sweep: Sweep, folder: Path, scenario: str = "") -> None:
        """Open the table in the folder of a sweep."""
        self.sweep, self.scenario = sweep, scenario
        self._folder = folder

    @functools.cached_property
    def _chosen(self) -> Any:
        if not self.scenario:
            return slice(None)
        return read_column(self._folder, SCENARIO).astype(str) == self.scenario

    def column(self, name: str) -> Any:
        """Return a column of the table; ``reached`` is 1 where the goal was reached, else 0."""
        if name == REACHED:
            return (self.column("outcome").astype(str) == REACHED).astype(float)
        return read_column(self._folder, name)[self._chosen]

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters that are numbers, by path."""
        found = self.sweep.space.parameters
        return {path: p for path, p in found.items() if _is_number(p)}

    @property
    def metrics(self) -> list[str]:
        """The columns that were asked for."""
        return list(measures(self.sweep.metrics))

    def fractions(self) -> list[tuple[str, int, int, tuple[float, float, float]]]:
        """Return outcome, count, number of runs, and fraction with Wilson's interval."""
        found = self.column("outcome").astype(str)
        counts = {name: int((found == name).sum()) for name in OUTCOMES}
        return [(name, n, len(found), fraction_of(n, len(found))) for name, n in counts.items()]

    def medians(self) -> list[tuple[str, int, tuple[float, float, float]]]:
        """Return metric, number of runs that know it, and median with bootstrap interval."""
        out = []
        for name in self.metrics:
            values = self.column(name)
            out.append((name, int(np.isfinite(values).sum()), median_interval(values)))
        return out

    def effects(self) -> list[Effect]:
        """Return the effect of each parameter on reaching the goal and on each metric."""
        return [
            _correlation(path, name, self.column(path), self.column(name))
            for name in (REACHED, *self.metrics)
            for path in self.parameters
        ]


def _is_number(parameter: Parameter) -> bool:
    if not isinstance(parameter, Choice):
        return True
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in parameter.values)


def _correlation(path: str, metric: str, x: Array, y: Array) -> Effect:
    """Return Spearman's rank correlation, with the interval of Bonett and Wright, 2000."""
    known = np.isfinite(y)
    x, y, n = x[known], y[known], int(known.sum())
    if n < 4 or not np.ptp(x) or not np.ptp(y):
        return Effect(path, metric, math.nan, math.nan, math.nan)
    r = float(optional("scipy.stats", "A rank correlation").spearmanr(x, y).statistic)
    z, half = (
        math.atanh(max(-0.999999, min(0.999999, r))),
        1.96 * math.sqrt((1.0 + 0.5 * r * r) / (n - 3)),
    )
    return Effect(path, metric, r, math.tanh(z - half), math.tanh(z + half))


def each_scenario(sweep: Sweep, folder: Path) -> list[Results]:
    """Return the results of each scenario."""
    names: Sequence[str] = tuple(sweep.scenarios)
    return [Results(sweep, folder, name if len(names) > 1 else "") for name in names]
