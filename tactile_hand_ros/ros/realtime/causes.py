# SPDX-License-Identifier: Apache-2.0
"""Why a tick was late: what this thread did, or had to wait for, since the tick began.

The kernel counts for each thread the time on a processor, the time that it was ready to run but had
to wait for one (preemption, by another process or by another thread of this one), and page faults;
collector and diagnostics are timed where they work. The time since the tick began, and the delay
with which it began, are split between these. The largest part is the cause; of computing only what
exceeds the usual counts, unless the usual alone takes nearly all of the time.
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

_BUSY = 0.7
"""Share of the time between two ticks from which usual computing counts as too much."""

_WEIGHT = 0.05
"""Weight of a tick in what is usual."""

_IDLE = "idle"
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


Parts = dict[str, float]
"""How long each cause took [s]."""


class TickWatch:
    """Explains why a tick is late; for the thread that creates it."""

    def __init__(self, timed: Mapping[str, Callable[[], float]], period: float) -> None:
        """Begin.

        Args:
            timed: By cause, a function that returns how long such work has taken in all [s].
            period: Time between two ticks [s].
        """
        self._timed = timed
        self._period = period
        self._schedstat = _open_schedstat()
        self._began = self._ended = self._count()
        self._is_open = False
        self._before: Parts = {}
        self._typical = 0.0
        self._last = UNKNOWN

    def close(self) -> None:
        """Let go of the kernel's file."""
        if self._schedstat is not None:
            os.close(self._schedstat)
            self._schedstat = None

    def begin(self, behind: float) -> None:
        """Note that a tick begins.

        Args:
            behind: How long after it was due [s]. What delayed it is among its causes.
        """
        now = self._count()
        self._before = {}
        if behind > 0.0 and not self._is_open:
            self._before = delays(self._ended, now, behind, self._last)
        self._began, self._is_open = now, True

    def end(self, *, in_time: bool) -> None:
        """Note that the tick has been answered, and learn from one in time what is usual."""
        self._ended, self._is_open = self._count(), False
        if in_time:
            used = self._ended.cpu - self._began.cpu
            self._typical += _WEIGHT * (used - self._typical) if self._typical else used

    def cause_before(self) -> str:
        """Return why the tick began late."""
        self._last = max(self._before, key=self._before.__getitem__) if self._before else UNKNOWN
        return self._last

    def cause(self, *, awaits_others: bool) -> str:
        """Return why the tick is late.

        Args:
            awaits_others: Whether idle time is spent waiting for other processes.
        """
        found = parts(self._began, self._count())
        idle = found.pop(_IDLE)
        found[OTHERS if awaits_others else UNKNOWN] = idle
        if self._typical < _BUSY * self._period:  # else the computer is simply too slow
            found[COMPUTING] -= self._typical
        for cause, seconds in self._before.items():
            found[cause] = found.get(cause, 0.0) + seconds
        self._last = max(found, key=found.__getitem__)
        return self._last

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


def parts(before: Counters, after: Counters) -> Parts:
    """Split the time between two counts; the rest of it, without a processor, is idle."""
    found = {cause: after.timed[cause] - seconds for cause, seconds in before.timed.items()}
    elsewhere = sum(found.values())
    cpu = after.cpu - before.cpu
    found[PREEMPTION] = after.delay - before.delay
    found[PAGE_FAULT] = min(cpu, _MINOR_FAULT * (after.minor - before.minor))
    found[COMPUTING] = max(0.0, cpu - elsewhere - found[PAGE_FAULT])
    idle = max(0.0, after.at - before.at - cpu - found[PREEMPTION])
    waits_for_disk = after.major > before.major
    found[PAGE_FAULT] += idle if waits_for_disk else 0.0
    found[_IDLE] = 0.0 if waits_for_disk else idle
    return found


def delays(before: Counters, after: Counters, behind: float, inherited: str) -> Parts:
    """Return what made a tick begin late.

    Args:
        before: When the one before it had been answered.
        after: When it began.
        behind: How late it began [s].
        inherited: Cause of the lateness of the one before it, which may go on.
    """
    passed = after.at - before.at
    found = parts(before, after)
    del found[_IDLE]
    found = {cause: min(seconds, behind) for cause, seconds in found.items()}
    carried = max(0.0, behind - passed)
    found[UNKNOWN] = max(0.0, behind - carried - sum(found.values()))
    found[inherited] = found.get(inherited, 0.0) + carried
    return found
