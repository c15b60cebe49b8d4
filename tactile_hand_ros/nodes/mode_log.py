# SPDX-License-Identifier: Apache-2.0
"""One INFO line at each change of a node's mode."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

_MOST = 5
"""Lines in a second; of more changes only the number is logged."""


class ModeLog:
    """Logs changes of mode at once, but no flood of them."""

    def __init__(
        self, log: Callable[[str], Any], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without a mode.

        Args:
            log: Takes a line.
            clock: Source of time [s].
        """
        self._log = log
        self._clock = clock
        self._mode = ""
        self._second = -1.0
        self._lines = self._unlogged = 0

    def note(self, mode: str, reason: str = "") -> None:
        """Note the mode in force, and why it is; the first one needs no line."""
        if mode == self._mode:
            return
        before, self._mode = self._mode, mode
        if not before:
            return
        now = self._clock()
        if now - self._second >= 1.0:
            self._second, self._lines = now, 0
        self._lines += 1
        if self._lines > _MOST:
            self._unlogged += 1
            return
        others = f" ({self._unlogged} changes before it not logged)" if self._unlogged else ""
        self._unlogged = 0
        self._log(f"{before} -> {mode}{others}" + (f": {reason}" if reason else ""))
