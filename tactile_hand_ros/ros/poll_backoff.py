# SPDX-License-Identifier: Apache-2.0
"""How often to look at what changes seldom but must be noticed soon, such as the ROS graph.

rclpy does not report changes of the graph, so one has to look. A graph that has been calm for a
while mostly stays so: then looking rarely is enough, and an idle node costs next to nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable


class PollBackoff:
    """Says how long to wait until the next look: short after a change, long when it is calm."""

    def __init__(
        self,
        often: float,
        rarely: float,
        calm_after: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin as after a change.

        Args:
            often: Time between two looks after a change [s].
            rarely: Time between two looks when it is calm [s].
            calm_after: How long after the last change it is calm [s].
            clock: Source of time [s].
        """
        self._often, self._rarely = often, max(often, rarely)
        self._calm_after = calm_after
        self._clock = clock
        self._changed_at = clock()

    def period(self, changed: bool) -> float:
        """Return the time until the next look [s].

        Args:
            changed: Whether this look found a change.
        """
        if changed:
            self._changed_at = self._clock()
        return self._rarely if self.is_calm else self._often

    @property
    def is_calm(self) -> bool:
        """Whether the last change was long ago."""
        return self._clock() - self._changed_at >= self._calm_after
