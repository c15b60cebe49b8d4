# SPDX-License-Identifier: Apache-2.0
"""Medians and shares with their confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.extras import optional

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Median and percentiles of a quantity, with the 95 % bootstrap interval of the median."""

    count: int
    median: float
    low: float
    high: float
    p90: float
    p99: float


def estimate(values: Sequence[float], seed: int = 0, resamples: int = 1000) -> Estimate:
    """Return median and percentiles; infinite values count as larger than all others.

    Args:
        values: The sample; NaN is left out.
        seed: Of the bootstrap.
        resamples: Number of bootstrap samples.
    """
    known = np.sort([v for v in values if not math.isnan(v)])
    if not len(known):
        return Estimate(0, *[math.nan] * 5)
    picks = np.random.default_rng(seed).integers(0, len(known), (resamples, len(known)))
    medians = _rank(np.sort(known[picks], axis=1).T, 0.5)
    low, high = _rank(np.sort(medians), 0.025), _rank(np.sort(medians), 0.975)
    middle = [_rank(known, share) for share in (0.5, 0.9, 0.99)]
    return Estimate(len(known), float(middle[0]), float(low), float(high), *map(float, middle[1:]))


def _rank(ordered: Array, share: float) -> Any:
    """Return a percentile that is one of the values: there is nothing between 1 and infinity."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def share(flags: Sequence[bool]) -> tuple[float, float, float]:
    """Return a share with its 95 % interval, see `share_of`."""
    return share_of(sum(flags), len(flags))


def share_of(count: int, n: int) -> tuple[float, float, float]:
    """Return what share of n a count is, with its 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    z = 1.96
    if not n:
        return math.nan, math.nan, math.nan
    p = count / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return p, max(0.0, middle - half), min(1.0, middle + half)


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
    shares = np.arange(1, n + 1) / n
    below = binomial.sf(math.ceil(0.5 * n) - 1, n, shares)  # P(median of a resample <= x_(j))
    low, high = (int(np.searchsorted(below, level)) for level in (0.025, 0.975))
    return float(_rank(known, 0.5)), float(known[low]), float(known[min(high, n - 1)])
