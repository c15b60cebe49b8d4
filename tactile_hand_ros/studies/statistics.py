# SPDX-License-Identifier: Apache-2.0
"""Medians and shares with their confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """Return a share with its 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    n, z = len(flags), 1.96
    if not n:
        return math.nan, math.nan, math.nan
    p = sum(flags) / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return p, max(0.0, middle - half), min(1.0, middle + half)
