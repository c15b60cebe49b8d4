# SPDX-License-Identifier: Apache-2.0
"""Baseline for real time: a process that only wakes at each tick.

No loop with work in it can meet the deadlines that this one misses on the same computer. As a
script with ``RATE SECONDS PRIORITY`` it is that process.
"""

from __future__ import annotations

import sys
import threading
import time

from tactile_hand_ros.ros.scheduling import raise_priority

_PATIENCE = 60.0  # s, in addition to the measured time


def missed_by_bare_loop(rate: float, seconds: float, priority: int = 0) -> float:
    """Return the fraction of ticks that a bare loop misses; `rate` in Hz, priority 0 is normal."""
    from bench.processes import CapturedProcess  # not importable in the process below

    words = [str(rate), str(seconds), str(priority)]
    with CapturedProcess([sys.executable, __file__, *words]) as process:
        process.wait(_PATIENCE + seconds)
        ticks, missed = map(int, process.stdout.split())
    return missed / ticks


def wake_at_each_tick(rate: float, seconds: float) -> tuple[int, int]:
    """Return the number of ticks and the number of missed ticks."""
    period, alarm = round(1e9 / rate), threading.Event()
    due = time.monotonic_ns() + period
    ticks, missed, end = 0, 0, due + round(1e9 * seconds)
    while due < end:
        alarm.wait(max(0.0, 1e-9 * (due - time.monotonic_ns())))
        skipped = max(0, time.monotonic_ns() - due) // period
        ticks, missed, due = ticks + 1 + skipped, missed + skipped, due + (1 + skipped) * period
    return ticks, missed


def main() -> None:
    """Run the loop and print its result."""
    rate, seconds, priority = (float(word) for word in sys.argv[1:4])
    raise_priority(int(priority))
    print(*wake_at_each_tick(rate, seconds))


if __name__ == "__main__":
    main()
