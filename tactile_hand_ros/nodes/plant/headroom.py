# SPDX-License-Identifier: Apache-2.0
"""Whether this computer is fast enough for the rate, and which one it could sustain."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

_WINDOW = 2.0
"""Time over which ticks are counted [s]."""

_TOLERATED = 0.1
"""Share of ticks that may be late or skipped before the computer counts as too slow."""

_RESERVE = 0.7
"""Share of the rate that was measured which is recommended: the machine's speed varies."""

_LEAST = 50.0
"""Lowest rate that is recommended [Hz]; a computer that falls below it is busy otherwise."""


class Headroom:
    """Compares the ticks that were answered in time with those that were due."""

    def __init__(
        self, rate: float, time_step: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start.

        Args:
            rate: Ticks per second that are asked for [Hz].
            time_step: Step of the simulation, of which a tick is a multiple [s].
            clock: Time [s].
        """
        self._rate = rate
        self._time_step = time_step
        self._clock = clock
        self._sentence = ""
        self.restart(0, 0)

    def restart(self, in_time: int, answered: int) -> None:
        """Count from here on.

        Args:
            in_time: Ticks that have been answered in time so far.
            answered: Commands that have come so far.
        """
        self._since, self._in_time, self._answered = self._clock(), in_time, answered

    def judge(self, in_time: int, answered: int, advice: str) -> str:
        """Return a sentence while the computer is too slow, empty while it is fast enough.

        Args:
            in_time: Ticks that have been answered in time so far.
            answered: Commands that have come so far.
            advice: What to do besides a lower rate.
        """
        passed = self._clock() - self._since
        if passed >= _WINDOW:
            share = (in_time - self._in_time) / (passed * self._rate)
            rate = (answered - self._answered) / passed
            slow = share < 1.0 - _TOLERATED
            self._sentence = self._complaint(share, rate, advice) if slow else ""
            self.restart(in_time, answered)
        return self._sentence

    def _complaint(self, share: float, answered: float, advice: str) -> str:
        rate = sustainable(answered, self._time_step)
        other = f"set plant.rate to {rate:g}" if rate >= _LEAST else "end other programs"
        return (
            f"this computer is too slow for {self._rate:g} Hz: {answered:.0f} ticks/s are answered,"
            f" {100.0 * share:.0f} % in time; {advice}, or {other}"
        )


def sustainable(answered: float, time_step: float) -> float:
    """Return a rate with some reserve, of which a tick is a whole number of steps [Hz].

    A whole number of Hz where there is one.

    Args:
        answered: Ticks per second that the computer answers [Hz].
        time_step: Step of the simulation [s].
    """
    most = min(1.0 / time_step, max(1.0, _RESERVE * answered))
    for rate in range(int(most), 0, -1):
        steps = 1.0 / (rate * time_step)
        if math.isclose(steps, round(steps), rel_tol=1e-9):
            return float(rate)
    return 1.0 / (math.ceil(1.0 / (most * time_step) - 1e-9) * time_step)
