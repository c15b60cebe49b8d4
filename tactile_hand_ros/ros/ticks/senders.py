# SPDX-License-Identifier: Apache-2.0
"""Notices that two publishers send on a topic that has one owner."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

_NUMBER = "publication_sequence_number"

_LASTING = 0.5
"""Time after which one fall of the numbers, and a conflict, are over [s]."""


def two_senders(topic: str) -> str:
    """Return what is wrong when two publishers send on a topic."""
    return f"two senders of {topic}; stop one of them (two hands need two namespaces)"


class SenderCheck:
    """Tells two publishers of a topic by the sequence numbers of their messages.

    The middleware numbers the messages of each publisher 1, 2, 3, ... From one publisher the
    numbers rise. A successor of one that was killed starts again at 1, so they fall once. Where two
    send in turn, the numbers fall again and again. The number of publishers does not show it: a
    publisher that was killed counts for ten seconds more, and its successor must be let in before.
    Where the middleware gives no numbers, nothing is found.

    Attributes:
        conflicts: How many messages showed a second sender.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without messages.

        Args:
            clock: Time [s].
        """
        self._clock = clock
        self._last = 0
        self._fell: float | None = None
        self._found: float | None = None
        self.conflicts = 0

    def note(self, info: Mapping[str, Any]) -> bool:
        """Note what the middleware says about a message; return whether two senders send."""
        number = info.get(_NUMBER)
        if number is None:
            return False
        if number <= self._last:
            now = self._clock()
            if self._fell is not None and now - self._fell < _LASTING:
                self._found = now
                self.conflicts += 1
            self._fell = now
        self._last = number
        return self.in_conflict

    @property
    def in_conflict(self) -> bool:
        """Whether a second sender was found within the last half second."""
        return self._found is not None and self._clock() - self._found < _LASTING

    def ended(self) -> bool:
        """Return whether a conflict was over since the last call."""
        if self._found is None or self.in_conflict:
            return False
        self._found = None
        return True
