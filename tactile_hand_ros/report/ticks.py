# SPDX-License-Identifier: Apache-2.0
"""Which ticks a page shows: all of them, or of a long run those that the eye would miss."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def shown(count: int, limit: int, signals: Sequence[Array], always: Rows) -> Rows:
    """Choose the ticks to show.

    Up to `limit` ticks are all shown. Of more, the run is cut into equal pieces, and of each the
    first tick is shown and those at which each signal is largest and smallest, so that no peak is
    lost to the eye; what room is left goes to ticks at equal distances.

    Args:
        count: Number of ticks.
        limit: About how many may be shown.
        signals: Whose peaks matter, each of shape (count,).
        always: Ticks that are shown in any case, such as those of events.

    Returns:
        Rows in ascending order.
    """
    if count <= limit:
        return np.arange(count)
    pieces = max(1, limit // (1 + 2 * len(signals)))
    edges = np.unique(np.linspace(0, count, pieces + 1).astype(np.int64))
    rows = [edges[:-1], always, np.array([count - 1])]
    for signal in signals:
        low = np.where(np.isnan(signal), np.inf, signal)
        high = np.where(np.isnan(signal), -np.inf, signal)
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            rows.append(np.array([start + low[start:end].argmin()]))
            rows.append(np.array([start + high[start:end].argmax()]))
    chosen = np.unique(np.concatenate(rows).astype(np.int64))
    even = np.linspace(0, count - 1, max(2, limit - len(chosen))).astype(np.int64)
    return np.union1d(chosen, even)
