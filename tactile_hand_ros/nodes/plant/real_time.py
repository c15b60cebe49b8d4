# SPDX-License-Identifier: Apache-2.0
"""Ticks that follow the wall clock: due, late and skipped ones, and a limit to the speed."""

from __future__ import annotations

import time
from collections.abc import Callable

_MOST_BEHIND_NS = 200_000_000
"""Delay beyond which time is dropped instead of caught up [ns]."""


class Pace:
    """Counts the ticks that are due at each call of a timer with the period of a tick.

    A tick is late if its command arrives after the next tick is due, or not at all. It is skipped
    if a later tick is due at the same call.

    Attributes:
        late: Number of late ticks.
        skipped: Number of skipped ticks.
        lost_ns: Wall time dropped because the machine was too slow [ns].
    """

    def __init__(self, tick_ns: int, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Create it stopped; the period of a tick and `clock` are in nanoseconds."""
        self._tick = tick_ns
        self._clock = clock
        self.late = self.skipped = self.lost_ns = 0
        self.start(awaits_command=False)

    def start(self, *, awaits_command: bool = True) -> None:
        """Make the first tick due one period from now; without a command if time stops."""
        self._due_at = self._clock() + self._tick
        self._awaits_command = awaits_command

    def due(self) -> int:
        """Return the number of ticks that are due now, and count them as done."""
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
        """Record that the command for the newest tick has arrived."""
        self.late += self._awaits_command and self._clock() > self._due_at
        self._awaits_command = False


class Brake:
    """Permits ticks no faster than a speed; what a slow tick has lost, the next ones make up.

    Attributes:
        speed: Simulated seconds per second, 0 for no limit.
        period: Time between two ticks [ns].
    """

    def __init__(self, tick_ns: int, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Create it without a limit; the period of a tick and `clock` are in nanoseconds."""
        self._tick, self._clock = tick_ns, clock
        self.set(0.0)

    def set(self, speed: float) -> None:
        """Change the speed."""
        self.speed, self.period = speed, round(self._tick / speed) if speed > 0.0 else 0
        self._due_at = self._clock()

    def permits(self) -> bool:
        """Return whether the next tick may come now, and count it."""
        now = self._clock()
        if self.speed > 0.0 and now < self._due_at - self.period // 2:  # timers may be early
            return False
        self._due_at = max(self._due_at, now - _MOST_BEHIND_NS) + self.period
        return True
