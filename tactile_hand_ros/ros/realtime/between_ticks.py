# SPDX-License-Identifier: Apache-2.0
"""Work that can wait, such as diagnostics, is done right after a tick and never during one.

A process that runs in real time queues it. At the end of each tick `tick_done` does one piece of
work, because most time is left then before the next tick. The plant ends the ticks of its process;
in a process without the plant each node does.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from weakref import WeakKeyDictionary

from rclpy.context import Context

from tactile_hand_ros.ros.realtime.causes import DIAGNOSTICS, RECORDER
from tactile_hand_ros.ros.realtime.garbage import GarbageRest

_PAUSE = 0.25
"""Time without a tick after which work need not wait [s]."""


class BetweenTicks:
    """The queue of one process.

    Attributes:
        spent: How long diagnostics and recorder have worked in all, by cause [s].
        garbage: The collector's rest.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Do work at once until `begin`.

        Args:
            clock: Time [s].
        """
        self.spent = {DIAGNOSTICS: 0.0, RECORDER: 0.0}
        self.garbage = GarbageRest()
        self._clock = clock
        self._waits = False
        self._has_plant = False
        self._last = -_PAUSE
        self._waiting: dict[Callable[[], None], None] = {}

    def begin(self) -> None:
        """Let work wait for the end of a tick from now on."""
        self._waits = True
        self.garbage.begin()

    def run(self, work: Callable[[], None]) -> None:
        """Do work now where no tick can be disturbed, else soon; the same work waits only once."""
        if self._is_ticking():
            self._waiting[work] = None
        else:
            self._waiting.pop(work, None)
            self._do(work)

    def tick_done(self, *, by_plant: bool = False) -> None:
        """Note the end of a tick and do what has waited longest.

        Args:
            by_plant: Whether the plant calls, which sees the end of the last of a tick's answers.
                Where it does, the other nodes' calls do not count.
        """
        if not self._waits or (self._has_plant and not by_plant):
            return
        self._has_plant = by_plant
        self._last = self._clock()
        if self._waiting:
            work = next(iter(self._waiting))
            del self._waiting[work]
            self._do(work)

    def rest(self) -> None:
        """Do all that waits: the ticks have stopped."""
        self._last = -_PAUSE
        while self._waiting:
            work = next(iter(self._waiting))
            del self._waiting[work]
            self._do(work)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Count the time inside the block as the recorder's."""
        began = self._clock()
        try:
            yield
        finally:
            self.spent[RECORDER] += self._clock() - began

    def _is_ticking(self) -> bool:
        return self._waits and self._clock() - self._last < _PAUSE

    def _do(self, work: Callable[[], None]) -> None:
        began, recorded = self._clock(), self.spent[RECORDER]
        try:
            work()
        finally:
            recording = self.spent[RECORDER] - recorded
            self.spent[DIAGNOSTICS] += self._clock() - began - recording
        self.garbage.tidy(is_idle=not self._is_ticking())


_queues: WeakKeyDictionary[Context, BetweenTicks] = WeakKeyDictionary()


def between_ticks(context: Context) -> BetweenTicks:
    """Return the queue of all nodes of a context."""
    return _queues.setdefault(context, BetweenTicks())
