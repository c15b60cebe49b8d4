# SPDX-License-Identifier: Apache-2.0
"""What a sweep shows: fractions, medians and sensitivities, as numbers and as a page of text."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import files
from tactile_hand_ros.extras import optional
from tactile_hand_ros.report import tables
from tactile_hand_ros.sweep.engine import OUTCOMES, REACHED
from tactile_hand_ros.sweep.metrics import measures
from tactile_hand_ros.sweep.space import Choice, Space
from tactile_hand_ros.sweep.statistics import fraction_of, median_interval
from tactile_hand_ros.sweep.sweep import Sweep
from tactile_hand_ros.sweep.table import Table

Array = NDArray[np.float64]
Interval = tuple[float, float, float]
"""A value and the ends of its 95 % interval."""


class Results:
    """The finished runs of a sweep.

    Attributes:
        sweep: What was asked.
        table: All columns.
    """

    def __init__(self, sweep: Sweep, table: Table) -> None:
        """Take a sweep and its table."""
        self.sweep, self.table = sweep, table

    def column(self, name: str) -> Any:
        """Return a column; ``reached`` is 1 where the goal was reached, else 0."""
        if name == REACHED:
            return (self.table["outcome"] == REACHED).astype(float)
        found = self.table.get(name)  # a metric that no run knows has no column
        return np.full(len(self.table["outcome"]), math.nan) if found is None else found

    @functools.cached_property
    def parameters(self) -> Space:
        """The parameters that are numbers, by path."""
        return {path: p for path, p in self.sweep.space.items() if _is_number(p)}

    @property
    def metrics(self) -> list[str]:
        """The columns that were asked for."""
        return list(measures(self.sweep.metrics))

    def fractions(self) -> list[tuple[str, int, int, Interval]]:
        """Return outcome, count, number of runs, and fraction with Wilson's interval."""
        found = self.table["outcome"]
        counts = {name: int((found == name).sum()) for name in OUTCOMES}
        return [(name, n, len(found), fraction_of(n, len(found))) for name, n in counts.items()]

    def medians(self) -> list[tuple[str, int, Interval]]:
        """Return metric, number of runs that know it, and median with bootstrap interval."""
        columns = {name: self.column(name) for name in self.metrics}
        return [(n, int(np.isfinite(c).sum()), median_interval(c)) for n, c in columns.items()]

    def effects(self) -> list[tuple[str, str, float]]:
        """Return parameter, metric or ``reached``, and rank correlation; the strongest first."""
        every = [
            (path, name, _correlation(self.column(path), self.column(name)))
            for name in (REACHED, *self.metrics)
            for path in self.parameters
        ]
        known = [effect for effect in every if not math.isnan(effect[2])]
        return sorted(known, key=lambda effect: -abs(effect[2]))


def _is_number(parameter: Any) -> bool:
    values = parameter.values if isinstance(parameter, Choice) else ()
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def _correlation(x: Array, y: Array) -> float:
    """Return Spearman's rank correlation; NaN where it is not known."""
    known = np.isfinite(y)
    if known.sum() < 4 or not np.ptp(x[known]) or not np.ptp(y[known]):
        return math.nan
    return float(optional("scipy.stats", "A rank correlation").spearmanr(x[known], y[known])[0])


SUMMARY = "summary.md"
FRACTION_COLUMNS = ("outcome", "runs", "fraction", "95 % interval")
EFFECT_COLUMNS = ("parameter", "metric", "rank correlation")
METRIC_COLUMNS = ("metric", "runs", "median", "95 % interval")


def fraction_rows(results: Results) -> list[list[str]]:
    """Return outcomes as text, columns as in `FRACTION_COLUMNS`."""
    return [
        [outcome, f"{count} of {runs}", *_texts(fraction, _percent)]
        for outcome, count, runs, fraction in results.fractions()
    ]


def metric_rows(results: Results) -> list[list[str]]:
    """Return metrics as text, columns as in `METRIC_COLUMNS`."""
    return [
        [name, str(count), *_texts(median, _number)] for name, count, median in results.medians()
    ]


def effect_rows(results: Results) -> list[list[str]]:
    """Return rank correlations as text, columns as in `EFFECT_COLUMNS`."""
    return [[parameter, name, _number(value)] for parameter, name, value in results.effects()]


def write_summary(results: Results, folder: Path, pictures: Sequence[Path]) -> Path:
    """Write the summary of a sweep with its figures; return the file."""
    sweep = results.sweep
    text = [
        f"# {sweep.base.name} over {', '.join(sweep.space)}\n",
        f"{sweep.runs} runs asked for, sampler {sweep.sampler}, seed {sweep.seed}. Each row of "
        "`runs.parquet` and `runs.csv` is a run.\n",
        tables.markdown(FRACTION_COLUMNS, fraction_rows(results)),
        tables.markdown(METRIC_COLUMNS, metric_rows(results)),
        tables.markdown(EFFECT_COLUMNS, effect_rows(results)),
        *(f"![{picture.stem}]({picture.name})\n" for picture in pictures),
    ]
    files.replace_text(folder / SUMMARY, "\n".join(text))
    return folder / SUMMARY


def _number(value: float) -> str:
    return f"{value:.3g}"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _texts(values: Sequence[float], text: Callable[[float], str]) -> tuple[str, str]:
    """Return a value and its interval as text."""
    if math.isnan(values[0]):
        return "unknown", ""
    return text(values[0]), f"{text(values[1])} to {text(values[2])}"
