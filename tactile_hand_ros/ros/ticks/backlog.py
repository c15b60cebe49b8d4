# SPDX-License-Identifier: Apache-2.0
"""Which ticks a slow node answers: the newest, and those that its peers answer too.

A node that is slower than its ticks and answers all of them answers ever older ones. This cannot
happen in lockstep, but it can in real time. So of several ticks that wait together some are
skipped. But a consumer that needs the answers of two nodes to the same tick gets neither if each
node skips other ticks. Each tick therefore has a rank: n where it is the first one in a stretch of
2^n ms but not of 2^(n+1) ms. It is skipped only where one of higher rank waits behind it. That one
comes no sooner than 2^n ms less one period later, so no node that lags by less skips it, and all
nodes meet again and again, however they lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

T = TypeVar("T")

_MILLISECOND = 1_000_000
_HIGHEST = 64


def rank(stamp_ns: int, previous_ns: int | None) -> int:
    """Return the rank of a tick after another one [ns]; without one it is the highest."""
    if previous_ns is None:
        return _HIGHEST
    return (stamp_ns // _MILLISECOND ^ previous_ns // _MILLISECOND).bit_length() - 1


def chosen(stamps: Sequence[int], previous: int | None) -> list[int]:
    """Return those of waiting ticks which nothing of higher rank follows.

    Args:
        stamps: What waits, oldest first [ns].
        previous: The tick before them [ns], None if there was none.
    """
    ranks = [rank(stamp, before) for stamp, before in zip(stamps, [previous, *stamps])]
    kept: list[int] = []
    highest = -1
    for stamp, own in zip(reversed(stamps), reversed(ranks), strict=True):
        if own >= highest:
            highest = own
            kept.append(stamp)
    return kept[::-1]


class Backlog(Generic[T]):
    """Complete ticks that wait until everything that has arrived is read.

    Attributes:
        skipped: Number of ticks that were skipped so far.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.skipped = 0
        self._waiting: dict[int, T] = {}
        self._previous: int | None = None

    def __len__(self) -> int:
        """Return how many ticks wait."""
        return len(self._waiting)

    def put(self, stamp_ns: int, values: T) -> None:
        """Add a complete tick [ns]; a second one of the same stamp replaces the first."""
        self._waiting[stamp_ns] = values

    def take(self) -> list[tuple[int, T, bool]]:
        """Return all ticks that waited, oldest first [ns], and whether each is to be answered."""
        waiting, self._waiting = self._waiting, {}
        stamps = list(waiting)
        answered = set(stamps)
        if len(stamps) > 1:
            answered = set(chosen(stamps, self._previous))
            self.skipped += len(stamps) - len(answered)
        if answered:
            self._previous = max(answered)
        return [(stamp, values, stamp in answered) for stamp, values in waiting.items()]

    def clear(self) -> None:
        """Forget the ticks that wait."""
        self._waiting, self._previous = {}, None
