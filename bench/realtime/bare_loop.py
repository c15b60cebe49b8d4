# SPDX-License-Identifier: Apache-2.0
"""The least that real time asks of a computer: a process that only wakes at each tick.

What it misses, no loop with work in it can keep on the same computer.

``python -m bench.realtime.bare_loop RATE SECONDS PRIORITY`` is that process.
"""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import dataclass

from tactile_hand_ros.ros.histogram import Histogram, parse_histogram
from tactile_hand_ros.ros.processes import CapturedProcess
from tactile_hand_ros.ros.scheduling import Scheduling

_PATIENCE = 60.0  # s, on top of the time that is measured


@dataclass(frozen=True)
class BareLoop:
    """What a bare loop achieved.

    Attributes:
        ticks: How many ticks came due.
        missed: Share of them at which it woke only when the next one was due.
        median_delay: Median time from a tick to the wake-up [s].
    """

    ticks: int
    missed: float
    median_delay: float


def measure_bare_loop(rate: float, seconds: float, priority: int = 0) -> BareLoop:
    """Let a process wake at each tick.

    Args:
        rate: Ticks per second [Hz].
        seconds: How long [s].
        priority: Under SCHED_FIFO; 0 for ordinary scheduling.
    """
    words = [str(rate), str(seconds), str(priority)]
    with CapturedProcess([sys.executable, __file__, *words]) as process:
        process.wait(_PATIENCE + seconds)
        ticks, missed, histogram = process.stdout.split(";")
    middles, counts = parse_histogram(histogram)
    median = float(middles[(counts.cumsum() >= counts.sum() / 2).argmax()])
    return BareLoop(int(ticks), int(missed) / int(ticks), median)


def wake_at_each_tick(rate: float, seconds: float) -> tuple[int, int, Histogram]:
    """Return how many ticks came due, how many of them came too late, and the delays."""
    period, delays, alarm = round(1e9 / rate), Histogram(), threading.Event()
    due = time.monotonic_ns() + period
    ticks, missed, end = 0, 0, due + round(1e9 * seconds)
    while due < end:
        alarm.wait(max(0.0, 1e-9 * (due - time.monotonic_ns())))
        behind = max(0, time.monotonic_ns() - due)
        delays.note(1e-9 * behind)
        ticks += 1 + behind // period
        missed += behind // period
        due += (1 + behind // period) * period
    return ticks, missed, delays


def main() -> None:
    """Run the loop and print what came of it."""
    rate, seconds, priority = (float(word) for word in sys.argv[1:4])
    Scheduling(priority=int(priority)).apply()
    ticks, missed, delays = wake_at_each_tick(rate, seconds)
    print(ticks, missed, delays.text(), sep=";")


if __name__ == "__main__":
    main()
