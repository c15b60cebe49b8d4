# SPDX-License-Identifier: Apache-2.0
"""Notices when one input keeps coming while the others that belong to it do not."""

from __future__ import annotations

import time
from collections.abc import Callable


class InputWatch:
    """Measures the time for which a trigger has come without a complete set of inputs.

    Silence of the trigger itself does not count: then there is nothing to answer. The time must
    have passed by the stamps of the triggers and by the wall clock. By the stamps, because in
    lockstep they stand still while a tick waits for its inputs: then all nodes wait for the one
    that stalls, and no result depends on how fast the machine is. The pacing need not be known: in
    real time and on a real hand the stamps go on, and silence is noticed. By the wall clock,
    because one stamp that lies ahead does not mean that time has passed.

    Attributes:
        blind: Whether the inputs are missing.
    """

    def __init__(self, timeout: float, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Take the time [s] after which inputs count as missing."""
        self._timeout = round(1e9 * timeout)
        self._clock = clock
        self._since: tuple[int, int] | None = None  # wall clock and stamp, ns
        self.blind = False

    def triggered(self, stamp_ns: int) -> bool:
        """Note a trigger whose set is not complete yet; return whether the inputs are missing."""
        if not self.blind:
            now = self._clock()
            if self._since is None or stamp_ns < self._since[1]:
                self._since = now, stamp_ns
            self.blind = min(now - self._since[0], stamp_ns - self._since[1]) >= self._timeout
        return self.blind

    def complete(self) -> bool:
        """Note a complete set; return whether the inputs had been missing."""
        was_blind, self.blind, self._since = self.blind, False, None
        return was_blind
