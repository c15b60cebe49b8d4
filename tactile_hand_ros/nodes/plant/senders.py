# SPDX-License-Identifier: Apache-2.0
"""Notices that two senders answer the same ticks."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MEMORY = 256
"""Ticks whose answers are remembered."""

_LASTING = 0.5
"""Time without another disagreement after which it counts as over [s]."""


class SenderWatch:
    """Compares the answers to each tick: one sender gives one answer, and repeats it to the bit.

    The number of publishers on a topic does not show it: a sender that was killed counts until the
    middleware gives it up, ten seconds later, and its successor must be let in before. Time is that
    of the wall clock: the plant makes the stamps, which `ros.ticks.one_sender` goes by, itself.

    Attributes:
        conflicts: How many answers disagreed with the first one to their tick.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without answers."""
        self._clock = clock
        self.conflicts = 0
        self.reset()

    def reset(self) -> None:
        """Forget all answers, because time starts over."""
        self._answers: OrderedDict[int, Array] = OrderedDict()
        self._last: float | None = None

    @property
    def in_conflict(self) -> bool:
        """Whether two senders have disagreed within the last half second."""
        return self._last is not None and self._clock() - self._last < _LASTING

    def ended(self) -> bool:
        """Return whether a disagreement was over since the last call."""
        if self._last is None or self.in_conflict:
            return False
        self._last = None
        return True

    def note(self, stamp: int, torque: Array) -> bool:
        """Note an answer, shape (m,), N m, to a tick, ns; return whether it is another one."""
        first = self._answers.setdefault(stamp, torque)
        if len(self._answers) > _MEMORY:
            self._answers.popitem(last=False)
        if np.array_equal(first, torque):
            return False
        self.conflicts += 1
        self._last = self._clock()
        return True
