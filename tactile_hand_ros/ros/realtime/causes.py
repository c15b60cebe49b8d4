# SPDX-License-Identifier: Apache-2.0
"""Why a tick was late: what this thread did, or had to wait for, since the tick began.

The kernel counts for each thread the time on a processor, the time that it was ready to run but had
to wait for one (preemption, by another process or by another thread of this one), and page faults;
collector and diagnostics are timed where they work. The time since the tick began is split between
these, and the largest part is the cause.
"""

from __future__ import annotations

import os
import resource
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

GARBAGE = "garbage collection"
PAGE_FAULT = "page fault"
PREEMPTION = "preemption"
RECORDER = "recorder"
DIAGNOSTICS = "diagnostics"
COMPUTING = "computing"
OTHERS = "waiting for other processes"
UNKNOWN = "unknown"
CAUSES = (GARBAGE, PAGE_FAULT, PREEMPTION, RECORDER, DIAGNOSTICS, COMPUTING, OTHERS, UNKNOWN)

_MINOR_FAULT = 1e-6
"""What a page fault without a disk costs, roughly [s]."""

_DELAY_FIELD = 1  # of schedstat: time on a processor, time ready but waiting for one, [ns]


@dataclass(frozen=True)
class Counters:
    """What was counted for a thread at some time.

    Attributes:
        at: The time [s].
        cpu: Its time on a processor [s].
        delay: Its time ready to run, but without a processor [s].
        major: Page faults that read from a disk.
        minor: Page faults that did not.
        timed: Time of work that is timed where it is done [s], by cause.
    """

    at: float
    cpu: float
    delay: float
    major: int
    minor: int
    timed: Mapping[str, float]


class TickWatch:
    """Explains how the time since the last tick was spent; for the thread that creates it."""

    def __init__(self, timed: Mapping[str, Callable[[], float]]) -> None:
        """Begin.

        Args:
            timed: By cause, a function that returns how long such work has taken in all [s].
        """
        self._timed = timed
        self._schedstat = _open_schedstat()
        self._before = self._count()

    def close(self) -> None:
        """Let go of the kernel's file."""
        if self._schedstat is not None:
            os.close(self._schedstat)
            self._schedstat = None

    def begin(self) -> None:
        """Note that a tick begins."""
        self._before = self._count()

    def cause(self, *, awaits_others: bool) -> str:
        """Return what took most of the time since the tick began.

        Args:
            awaits_others: Whether idle time is spent waiting for other processes.
        """
        return largest(self._before, self._count(), awaits_others=awaits_others)

    def _count(self) -> Counters:
        usage = resource.getrusage(resource.RUSAGE_THREAD)
        return Counters(
            time.monotonic(),
            time.thread_time(),
            self._delay(),
            usage.ru_majflt,
            usage.ru_minflt,
            {cause: seconds() for cause, seconds in self._timed.items()},
        )

    def _delay(self) -> float:
        if self._schedstat is None:
            return 0.0
        try:
            text = os.pread(self._schedstat, 64, 0)
        except OSError:  # the thread that it counts for has ended
            return 0.0
        return 1e-9 * int(text.split()[_DELAY_FIELD])


def _open_schedstat() -> int | None:
    """Open the scheduler's figures for this thread; None where the kernel keeps none."""
    try:
        return os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY)
    except OSError:
        return None


def largest(before: Counters, after: Counters, *, awaits_others: bool) -> str:
    """Return what took most of the time between two counts.

    Args:
        before: When the tick began.
        after: When it was late.
        awaits_others: Whether idle time is spent waiting for other processes.
    """
    parts = {cause: after.timed[cause] - seconds for cause, seconds in before.timed.items()}
    parts[PREEMPTION] = after.delay - before.delay
    cpu = after.cpu - before.cpu
    faulting = min(cpu, _MINOR_FAULT * (after.minor - before.minor))
    parts[COMPUTING] = cpu - faulting - sum(after.timed[c] - s for c, s in before.timed.items())
    idle = after.at - before.at - cpu - parts[PREEMPTION]
    parts[PAGE_FAULT] = faulting
    if after.major > before.major:
        parts[PAGE_FAULT] += idle
    else:
        parts[OTHERS if awaits_others else UNKNOWN] = idle
    return max(parts, key=lambda cause: parts[cause])
