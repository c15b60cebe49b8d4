# SPDX-License-Identifier: Apache-2.0
"""Notices when one input keeps coming while the others that belong to it do not."""

from __future__ import annotations

import time
from collections.abc import Callable


class InputWatch:
    """Measures the time for which a trigger has come without a complete set of inputs.

    Silence of the trigger itself does not count: then there is nothing to answer.

    Attributes:
        blind: Whether the inputs are missing.
    """

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Take the time [s] after which inputs count as missing."""
        self._timeout = timeout
        self._clock = clock
        self._since: float | None = None
        self.blind = False

    def triggered(self) -> bool:
        """Note a trigger whose set is not complete yet; return whether the inputs are missing."""
        if not self.blind:
            if self._since is None:
                self._since = self._clock()
            self.blind = self._clock() - self._since >= self._timeout
        return self.blind

    def complete(self) -> bool:
        """Note a complete set; return whether the inputs had been missing."""
        was_blind, self.blind, self._since = self.blind, False, None
        return was_blind
