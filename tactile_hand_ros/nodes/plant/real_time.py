# SPDX-License-Identifier: Apache-2.0
"""Ticks that follow the wall clock: how many are due, and which were late or skipped."""

from __future__ import annotations

import time
from collections.abc import Callable

_MOST_BEHIND_NS = 200_000_000
"""Delay beyond which time is given up instead of made up for [ns]."""


class Pace:
    """Returns at each call of a timer with the period of a tick how many ticks have come due.

    A tick is late when its command arrives after the next tick is due, or not at all. It is skipped
    when it comes due together with a later one.

    Attributes:
        late: Ticks whose command was late or never came.
        skipped: Ticks that came due together with a later one, so that no node saw them.
        lost_ns: Wall time that was given up because the machine could not follow [ns].
    """

    def __init__(self, tick_ns: int, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Prepare.

        Args:
            tick_ns: Length of a tick [ns].
            clock: Time [ns].
        """
        self._tick = tick_ns
        self._clock = clock
        self.late = self.skipped = self.lost_ns = 0
        self.start()
        self.stop()

    def start(self) -> None:
        """Let the first tick come due one tick from now."""
        self._due_at = self._clock() + self._tick
        self._awaits_command = True

    def stop(self) -> None:
        """Expect no command for the newest tick: time stands still."""
        self._awaits_command = False

    def due(self) -> int:
        """Return how many ticks are due now, and count them as done."""
        behind = self._clock() - self._due_at
        if behind < -self._tick // 2:  # a timer may be early, but not by half a tick
            return 0
        count = max(1, behind // self._tick + 1)
        if behind > _MOST_BEHIND_NS:
            self.lost_ns += behind
            self._due_at += behind
            count = 1
        self._due_at += count * self._tick
        self.late += self._awaits_command
        self.skipped += count - 1
        self._awaits_command = True
        return count

    def answered(self) -> None:
        """Note that the command for the newest tick has arrived."""
        self.late += self._awaits_command and self._clock() > self._due_at
        self._awaits_command = False

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report counters, each as key and value."""
        put("late_commands", self.late)
        put("missed_ticks", self.skipped)
        put("lost_s", 1e-9 * self.lost_ns)
