# SPDX-License-Identifier: Apache-2.0
"""The garbage collector rests while ticks are answered, within a bound.

Reference counting frees what a tick makes. The collector only looks for cycles, and a tick leaves
none: it would walk over all objects and find nothing. `tidy` collects when no ticks come, and in
between only when far more objects have been made than freed.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

MOST_NEW = 50_000
"""Objects made and not freed after which a collection is due, ticks or not: about 1 ms of it."""

_WORTH_IT = 500
"""Objects made and not freed below which even an idle process does not collect."""


class GarbageRest:
    """Keeps the collector of this process from interrupting.

    Attributes:
        collections: How many were made since `begin`.
        forced: How many of them could not wait for a pause.
    """

    def __init__(self) -> None:
        """Change nothing yet."""
        self.collections = self.forced = 0
        self._is_resting = False

    def begin(self) -> None:
        """Collect once, set aside what exists for good, and let the collector rest."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self._is_resting = True

    def tidy(self, *, is_idle: bool) -> None:
        """Collect if that is due; call it between ticks.

        Args:
            is_idle: Whether no tick is waiting for this process.
        """
        if not self._is_resting:
            return
        new = gc.get_count()[0]
        if new > (_WORTH_IT if is_idle else MOST_NEW):
            self.collections += 1
            self.forced += not is_idle
            gc.collect()

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report counters, each as key and value."""
        if self._is_resting:
            put("garbage_collections", self.collections)
            put("garbage_collections_forced", self.forced)


class CollectionClock:
    """How long the collector of this process has worked in all, for any caller.

    Attributes:
        seconds: The sum [s].
    """

    def __init__(self) -> None:
        """Begin to count."""
        self.seconds = 0.0
        self._began = 0.0
        gc.callbacks.append(self._note)

    def close(self) -> None:
        """Stop counting."""
        gc.callbacks.remove(self._note)

    def _note(self, phase: str, _: dict[str, int]) -> None:
        now = time.perf_counter()
        if phase == "start":
            self._began = now
        else:
            self.seconds += now - self._began
