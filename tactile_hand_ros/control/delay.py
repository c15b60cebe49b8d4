# SPDX-License-Identifier: Apache-2.0
"""Delay of the joints' torques, from the torques that they report."""

from __future__ import annotations

from collections import deque

import numpy as np

from tactile_hand_ros.compiled import Array

_TICKS = 64  # over which differences are averaged


class TorqueDelay:
    """Finds after how many ticks the joints apply a torque.

    Changes of the reported torques are compared with changes of the sent ones, so that an offset
    does not count. Where noise hides them, or joints report no torques, the delay stays unknown.

    Attributes:
        ticks: The delay, 0 if a torque acts until the next tick; None if unknown.
    """

    def __init__(self, largest: int) -> None:
        """Start without a delay; `largest` is the largest possible one, in ticks."""
        self.ticks: int | None = None
        self._differences = np.zeros(largest + 1)
        self._sent: deque[Array] = deque(maxlen=largest + 2)  # the newest first
        self.pause()

    @property
    def allowed(self) -> int:
        """The delay to allow for, in ticks: the largest one if it is unknown."""
        return len(self._differences) - 1 if self.ticks is None else self.ticks

    def pause(self) -> None:
        """Forget what was sent, before other torques act; the delay remains."""
        self._sent.clear()
        self._applied: Array | None = None

    def step(self, applied: Array | None) -> None:
        """Compare torques that acted since the last tick, shape (m,), N m; None if unknown."""
        before, self._applied = self._applied, applied
        if before is None or applied is None or len(self._sent) < len(self._differences) + 1:
            return
        away = np.diff(self._sent, axis=0) + (applied - before)
        self._differences += ((away**2).sum(axis=1) - self._differences) / _TICKS
        best = int(self._differences.argmin())
        others = np.delete(self._differences, best)
        if (self._differences[best] < 0.5 * others).all():
            self.ticks = best

    def sent(self, torque: Array) -> None:
        """Record the torque that answers this tick, shape (m,), N m."""
        self._sent.appendleft(torque)
