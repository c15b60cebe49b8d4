# SPDX-License-Identifier: Apache-2.0
"""Counting of lost messages from the publishers' own sequence numbers."""

from __future__ import annotations

from collections import Counter


class SequenceTracker:
    """Counts the gaps in the sequence numbers of one topic.

    Each publisher numbers its messages 1, 2, 3, ... but a message does not say whose number it
    carries. A number that continues any known publisher belongs to it; number 1 is a new
    publisher; any other number is a gap in the nearest publisher below it. For one publisher the
    count is exact; for several that lose at once it is an estimate.

    The first message of a publisher that was there before the recorder starts its numbering: while
    fewer publishers were heard than there are, a number out of order is the first of another one.

    Attributes:
        lost: Number of messages that never came.
        publishers: How many publishers the topic has.
    """

    def __init__(self, publishers: int = 1) -> None:
        """Start before the first message."""
        self.lost = 0
        self.publishers = publishers
        self._next: Counter[int] = Counter()

    def see(self, number: int) -> None:
        """Account for one received message.

        Args:
            number: Sequence number, from 1.
        """
        if not self._next[number]:
            self._open(number)
        self._next[number] -= 1
        if not self._next[number]:
            del self._next[number]
        self._next[number + 1] += 1

    def _open(self, number: int) -> None:
        """Make `number` an expected one: of a new publisher, or behind a gap."""
        below = [expected for expected, count in self._next.items() if count and expected < number]
        del self._next[number]
        if number > 1 and below and self._next.total() >= self.publishers:
            nearest = max(below)
            self.lost += number - nearest
            self._next[nearest] -= 1
            if not self._next[nearest]:
                del self._next[nearest]
        self._next[number] += 1
