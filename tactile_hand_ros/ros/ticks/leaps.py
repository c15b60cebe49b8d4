# SPDX-License-Identifier: Apache-2.0
"""Separates stamps that go on from one that leaps ahead of all others."""

from __future__ import annotations

_SHORTEST_NS = 100_000_000
"""A step ahead that is no leap, whatever the ticks are [ns]."""


class Leaps:
    """Doubts a stamp far ahead of the last one until a second one confirms it.

    One message with a wrong stamp must not take a node ahead, where it would ignore all that comes
    until time has caught up. Far is more than a tenth of a second and twice the last step. Ticks
    that were lost cost one tick more. Stamps that go back are not judged here.
    """

    def __init__(self) -> None:
        """Start without a stamp: the first one is believed."""
        self._last: int | None = None
        self._step = 0
        self._doubted: int | None = None

    def doubts(self, stamp: int) -> bool:
        """Note a stamp, ns, and return whether it leaps ahead and nothing has confirmed it yet.

        What confirms it is the same stamp again, or a later one with none in between that goes on
        from the last.
        """
        last, doubted = self._last, self._doubted
        if last is not None and stamp - last > max(_SHORTEST_NS, 2 * self._step):
            self._doubted = stamp
            if doubted is None or stamp < doubted:
                return True
        self._step = 0 if last is None else max(0, stamp - last)
        self._last, self._doubted = stamp, None
        return False
