# SPDX-License-Identifier: Apache-2.0
"""Counts of durations in bins that grow with them: the tail of a whole run in a hundred numbers.

Percentiles over a window forget the one tick in a thousand that decides whether a loop is fit for
real time. Bins of equal ratio keep it, at a fraction of a microsecond a duration.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_LEAST = 1e-6  # s; all that is shorter counts as this
_DECADES = 7
_PER_DECADE = 24
_BINS = _DECADES * _PER_DECADE
_MIDDLES = _LEAST * 10.0 ** ((np.arange(_BINS) + 0.5) / _PER_DECADE)
_NAMES = [f"{1e6 * middle:.4g}" for middle in _MIDDLES.tolist()]


class Histogram:
    """Counts durations from 1 us to 10 s in bins that are a tenth as wide as they are long.

    Attributes:
        count: Number of durations.
        largest: The longest [s].
    """

    def __init__(self) -> None:
        """Begin empty."""
        self.count = 0
        self.largest = 0.0
        self._counts = [0] * _BINS

    def note(self, seconds: float) -> None:
        """Count a duration [s]."""
        self.count += 1
        if seconds > self.largest:
            self.largest = seconds
        place = int(_PER_DECADE * math.log10(seconds / _LEAST)) if seconds > _LEAST else 0
        self._counts[min(place, _BINS - 1)] += 1

    def quantile(self, fraction: float) -> float:
        """Return the middle of the bin in which a quantile lies [s]; at least one is counted."""
        rank = np.searchsorted(np.cumsum(self._counts), max(1.0, fraction * self.count))
        return float(_MIDDLES[rank])

    def text(self) -> str:
        """Return it as one line, ``middle of a bin in us:count`` separated by blanks."""
        filled = [(name, count) for name, count in zip(_NAMES, self._counts, strict=True) if count]
        return " ".join(f"{name}:{count}" for name, count in filled)


def percentiles(values: NDArray[np.float64]) -> dict[str, float]:
    """Return median, 99th percentile and maximum as ``p50``, ``p99`` and ``max``.

    The nearest of the values. `numpy.percentile`, which interpolates, takes four times as long.

    Args:
        values: At least one.
    """
    last = len(values) - 1
    ranks = {"p50": last // 2, "p99": round(0.99 * last), "max": last}
    ordered = np.partition(values, sorted(set(ranks.values())))
    return {name: float(ordered[rank]) for name, rank in ranks.items()}


def parse_histogram(text: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read what `Histogram.text` wrote.

    Args:
        text: The line.

    Returns:
        The middles of the bins [s] and the counts in them; empty bins are left out.
    """
    pairs = [pair.split(":") for pair in text.split()]
    middles = np.array([1e-6 * float(middle) for middle, _ in pairs])
    return middles, np.array([int(count) for _, count in pairs], dtype=np.int64)
