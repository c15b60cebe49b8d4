# SPDX-License-Identifier: Apache-2.0
"""Time of a bag against time on the wall: rate, pause and jumps."""

from __future__ import annotations


class Timeline:
    """Knows when something of the bag is due; starts paused.

    Times of the bag are in ns, times on the wall in s of any steady clock.
    """

    def __init__(self, position: int, rate: float = 1.0) -> None:
        """Stand at a time of the bag.

        Args:
            position: Time of the bag, ns.
            rate: Seconds of the bag per second on the wall.
        """
        self._position = position
        self._rate = rate
        self._since: float | None = None

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._since is None

    def pause(self, now: float) -> None:
        """Stand still."""
        self._position, self._since = self.position(now), None

    def resume(self, now: float) -> None:
        """Go on, or keep going."""
        self._position, self._since = self.position(now), now

    def jump(self, position: int, now: float) -> None:
        """Go on, or stand, from another time of the bag."""
        self._position = position
        if self._since is not None:
            self._since = now

    def position(self, now: float) -> int:
        """Return the time of the bag, ns."""
        if self._since is None:
            return self._position
        return self._position + round(1e9 * self._rate * (now - self._since))

    def wait(self, position: int, now: float) -> float | None:
        """Return how long a time of the bag is ahead in s, not above 0 when due; None if paused."""
        if self._since is None:
            return None
        return self._since - now + 1e-9 * (position - self._position) / self._rate
