# SPDX-License-Identifier: Apache-2.0
"""Ticks that follow the wall clock: how many are due, how late they are, what was lost."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tactile_hand_ros.ros.histogram import Histogram, percentiles

_WINDOW = 4096
"""Latest delays of which percentiles are reported."""

_MOST_BEHIND_NS = 200_000_000
"""Delay beyond which time is given up instead of made up for [ns]."""


class Pace:
    """Says at each call of a timer with the period of a tick how many ticks have come due.

    Attributes:
        missed: Ticks that came due together with a later one, so that no node saw them.
        behind_ns: How late the first of the ticks was that came due last [ns].
        lost_ns: Wall time that was given up because the machine could not follow [ns].
        jitter: How far from its time each tick came.
        ages: How old a tick was when its command came, of all ticks that were answered.
    """

    def __init__(
        self, tick_ns: int, busy_wait_ns: int = 0, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Prepare.

        Args:
            tick_ns: Length of a tick [ns].
            busy_wait_ns: How long before a tick `due` begins to watch the clock [ns].
            clock: Time [ns].
        """
        self._tick = tick_ns
        self._lead = min(busy_wait_ns, tick_ns // 2)
        self._clock = clock
        self.missed = 0
        self.behind_ns = 0
        self.lost_ns = 0
        self.jitter, self.ages = Histogram(), Histogram()
        self._delays = np.zeros(_WINDOW)
        self._delay_count = 0
        self.start()

    def start(self) -> None:
        """Let the first tick come due one tick from now, or that later that `due` waits."""
        self._due_at = self._clock() + self._tick + self._lead

    @property
    def overdue_ns(self) -> int:
        """How long ago the next tick came due [ns], negative if it will."""
        return self._clock() - self._due_at

    def due(self) -> int:
        """Return how many ticks are due now, and count them as done; wait for one nearly due."""
        behind = self._clock() - self._due_at
        while -self._lead <= behind < 0:
            behind = self._clock() - self._due_at
        if behind < -self._tick // 2:  # a timer may be early, but not by half a tick
            return 0
        count = max(1, behind // self._tick + 1)
        self.behind_ns = max(0, behind)
        self.jitter.note(1e-9 * abs(behind))
        if behind > _MOST_BEHIND_NS:
            self.lost_ns += behind
            self._due_at += behind
            count, behind = 1, 0
        self._delays[self._delay_count % _WINDOW] = 1e-9 * behind
        self._delay_count += 1
        self._due_at += count * self._tick
        self.missed += count - 1
        return count

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report counters and delays, each as key and value."""
        put("missed_ticks", self.missed)
        put("lost_s", 1e-9 * self.lost_ns)
        count = min(self._delay_count, _WINDOW)
        if count:
            for name, late in percentiles(np.abs(self._delays[:count])).items():
                put(f"jitter_{name}_us", f"{1e6 * late:.0f}")
            put("jitter_histogram_us", self.jitter.text())
        if self.ages.count:
            put("age_histogram_us", self.ages.text())
