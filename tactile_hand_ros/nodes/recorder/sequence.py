# SPDX-License-Identifier: Apache-2.0
"""Counting of lost messages from the publishers' own sequence numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable


class SequenceTracker:
    """Counts the gaps in the sequence numbers of one topic.

    Each publisher numbers its messages 1, 2, 3, ... but a message does not say whose number it
    carries. A number that continues any known publisher belongs to it; number 1 is a new
    publisher; any other number is a gap in the nearest publisher below it. For one publisher the
    count is exact; for several that lose at once it is an estimate.

    A publisher that may be older than the subscription can start with any number. One that appears
    later starts with 1: what it publishes before it finds the subscription is lost.

    Attributes:
        lost: Number of messages that never came.
    """

    def __init__(self, publishers: int = 1, look: Callable[[], None] = lambda: None) -> None:
        """Start before the first message.

        Args:
            publishers: How many publishers are older than the subscription.
            look: Called before a number out of order is judged; may call `change`.
        """
        self.lost = 0
        self._look = look
        self._older = publishers  # of which nothing was received yet
        self._younger = 0
        self._next: Counter[int] = Counter()

    def change(self, present: int, older: int = 0, younger: int = 0) -> None:
        """Account for publishers that came or went.

        Args:
            present: How many there are now.
            older: How many were discovered that may be older than the subscription.
            younger: How many were discovered that are not.
        """
        self._older = min(self._older + older, present)
        self._younger = min(self._younger + younger, present)

    def see(self, number: int) -> None:
        """Account for one received message.

        Args:
            number: Sequence number, from 1.
        """
        if not self._next[number]:
            self._look()
            self._open(number)
        self._take(number)
        self._next[number + 1] += 1

    def _open(self, number: int) -> None:
        """Make `number` an expected one: of a new publisher, or behind a gap."""
        del self._next[number]
        below = [expected for expected in self._next if expected < number]
        if self._older:
            self._older -= 1
        elif self._younger:
            self._younger -= 1
            self.lost += number - 1
        elif number > 1 and below:
            nearest = max(below)
            self.lost += number - nearest
            self._take(nearest)
        self._next[number] += 1

    def _take(self, number: int) -> None:
        """Remove one publisher of which `number` was expected."""
        self._next[number] -= 1
        if not self._next[number]:
            del self._next[number]
