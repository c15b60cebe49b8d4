# SPDX-License-Identifier: Apache-2.0
"""The results of a sweep: outcome fractions and medians, as numbers and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_hand_ros import files
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.extras import optional
from tactile_hand_ros.report import tables
from tactile_hand_ros.sweep.engine import OUTCOMES, Study
from tactile_hand_ros.sweep.sweep import METRICS, ScenarioRun
from tactile_hand_ros.sweep.table import Table

Interval = tuple[float, float, float]
"""A value and the ends of its 95 % interval."""


def rank(ordered: Array, fraction: float) -> Any:
    """Return a percentile that is one of the values, because values may be infinite."""
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)]


def fraction_of(count: int, n: int) -> Interval:
    """Return count / n with its 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    if not n:
        return math.nan, math.nan, math.nan
    test = optional("scipy.stats", "An interval").binomtest(count, n)
    interval = test.proportion_ci(method="wilson")
    return count / n, float(interval.low), float(interval.high)


def median_interval(values: Array) -> Interval:
    """Return the median of a sample, shape (n,), with its 95 % bootstrap interval; NaN is ignored.

    No resampling is needed for large samples: the median of a resample is the order statistic x_(j)
    or less if at least half of its n draws are among the j smallest values, which are
    Binomial(n, j / n).

    Source: Efron, Bootstrap methods: another look at the jackknife, 1979, section 3.
    """
    known = np.sort(values[~np.isnan(values)])
    n = len(known)
    if not n:
        return math.nan, math.nan, math.nan
    binomial = optional("scipy.stats", "A bootstrap interval").binom
    fractions = np.arange(1, n + 1) / n
    below = binomial.sf(math.ceil(0.5 * n) - 1, n, fractions)  # P(median of a resample <= x_(j))
    low, high = (int(np.searchsorted(below, level)) for level in (0.025, 0.975))
    return float(rank(known, 0.5)), float(known[low]), float(known[min(high, n - 1)])


class Results:
    """The finished runs of a sweep."""

    def __init__(self, study: Study, table: Table) -> None:
        """Take a sweep of `make_sweep` and its table."""
        self.study, self.table = study, table
        assert isinstance(study.run, ScenarioRun)
        self.scenario = study.run.base.name

    def column(self, name: str) -> Any:
        """Return a column of the table."""
        found = self.table.get(name)  # a metric that is unknown in all runs has no column
        return np.full(len(self.table["outcome"]), math.nan) if found is None else found

    def fractions(self) -> list[tuple[str, int, int, Interval]]:
        """Return outcome, count, number of runs, and fraction with Wilson's interval."""
        found = self.table["outcome"]
        counts = {name: int((found == name).sum()) for name in OUTCOMES}
        return [(name, n, len(found), fraction_of(n, len(found))) for name, n in counts.items()]

    def medians(self) -> list[tuple[str, int, Interval]]:
        """Return metric, number of runs that have it, and median with bootstrap interval."""
        columns = {name: self.column(name) for name in METRICS}
        return [(n, int(np.isfinite(c).sum()), median_interval(c)) for n, c in columns.items()]


def summary_tables(results: Results) -> list[tuple[tuple[str, ...], list[list[str]]]]:
    """Return columns and rows of the outcomes and of the metrics, as text."""
    outcomes = [
        [outcome, f"{count} of {runs}", *_texts([100.0 * x for x in fraction], "{:.1f} %")]
        for outcome, count, runs, fraction in results.fractions()
    ]
    metrics = [
        [name, str(count), *_texts(median, "{:.3g}")] for name, count, median in results.medians()
    ]
    return [
        (("outcome", "runs", "fraction", "95 % interval"), outcomes),
        (("metric", "runs", "median", "95 % interval"), metrics),
    ]


def write_summary(results: Results, folder: Path) -> Path:
    """Write the summary of a sweep and return the file."""
    study = results.study
    text = [
        f"# {results.scenario} over {', '.join(study.space)}\n",
        f"Seed {study.seed}. Each row of `runs.csv` is a run.\n",
        *(tables.markdown(*table) for table in summary_tables(results)),
    ]
    file = folder / "summary.md"
    files.replace_text(file, "\n".join(text))
    return file


def _texts(interval: Sequence[float], form: str) -> tuple[str, str]:
    value, low, high = (form.format(number) for number in interval)
    return ("unknown", "") if math.isnan(interval[0]) else (value, f"{low} to {high}")
