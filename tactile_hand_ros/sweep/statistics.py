# SPDX-License-Identifier: Apache-2.0
"""Medians and fractions with their confidence intervals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.extras import optional

Array = NDArray[np.float64]


def rank(ordered: Array, fraction: float) -> Any:
    """Return a percentile that is one of the values: there is nothing between 1 and infinity."""
    return ordered[max(0, math.ceil(fraction * len(ordered)) - 1)]


def fraction_of(count: int, n: int) -> tuple[float, float, float]:
    """Return which fraction of n a count is, with its 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    if not n:
        return math.nan, math.nan, math.nan
    test = optional("scipy.stats", "An interval").binomtest(count, n)
    interval = test.proportion_ci(method="wilson")
    return count / n, float(interval.low), float(interval.high)


def median_interval(values: Array) -> tuple[float, float, float]:
    """Return the median of a large sample with its 95 % bootstrap interval, without resampling.

    The median of a resample is the order statistic x_(j) or less if at least half of its n draws
    are among the j smallest values, which are Binomial(n, j / n).

    Source: Efron, Bootstrap methods: another look at the jackknife, 1979, section 3.

    Args:
        values: The sample, shape (n,); NaN is left out.
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
