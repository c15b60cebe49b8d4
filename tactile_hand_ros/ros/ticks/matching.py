# SPDX-License-Identifier: Apache-2.0
"""Brings together the messages of one tick, in any order, and filters stamps that jump."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal

_SECOND = 1_000_000_000
_SHORTEST_LEAP = 100_000_000
"""A step ahead that is no leap, whatever the ticks are [ns]."""


class Repeat(enum.Enum):
    """Type of `REPEAT`."""

    REPEAT = enum.auto()


REPEAT: Final = Repeat.REPEAT
"""The tick was answered already: publish the last answer again."""

_MISSING: Final = object()


class _Open:
    """The values of a tick, in the order of the keys, and how many are still missing."""

    __slots__ = ("missing", "values")

    def __init__(self, count: int) -> None:
        self.values: list[Any] = [_MISSING] * count
        self.missing = count

    def put(self, index: int, value: Any) -> bool:
        """Add or replace a value; return whether all are there."""
        # By identity: arrays do not compare to one truth.
        self.missing -= self.values[index] is _MISSING
        self.values[index] = value
        return not self.missing


class StampMatcher:
    """Collects one value per key and stamp, and gives the values of a stamp when all are there.

    Sets come in the order of their stamps and never mix stamps. A set that stays incomplete is
    given up when a newer one is complete. A complete set at stamp 0, or more than
    ``restart_after_ns`` before the last one, means that the senders have started over: everything
    else is forgotten then. A single old message means nothing.
    """

    def __init__(
        self,
        keys: Sequence[str],
        *,
        memory: int = 100,
        restart_after_ns: int = _SECOND,
        on_restart: Callable[[], None] | None = None,
    ) -> None:
        """Name the streams.

        Args:
            keys: One key per stream; the first is the one whose repetition means that the tick
                is asked for again.
            memory: Incomplete stamps that are kept; the first to come are the first to go.
            restart_after_ns: Jump back in time that means a restart [ns].
            on_restart: Called when the senders have started over, before their first set is given.
        """
        self.keys = tuple(keys)
        self._index = {key: index for index, key in enumerate(self.keys)}
        self._memory = memory
        self._restart_after = restart_after_ns
        self._on_restart = on_restart
        self.last: int | None = None
        self._pending: dict[int, _Open] = {}

    @property
    def pending(self) -> int:
        """How many incomplete stamps are kept."""
        return len(self._pending)

    def put(
        self, key: str, stamp_ns: int, value: Any
    ) -> tuple[Any, ...] | Literal[Repeat.REPEAT] | None:
        """Add a value.

        Args:
            key: Stream of the value.
            stamp_ns: Its tick [ns].
            value: The value; a later one of the same tick replaces it.

        Returns:
            All values of the tick in the order of the keys when this one made it complete,
            `REPEAT` when the first key asks for the last complete tick again, else None.
        """
        index = self._index[key]
        last = self.last
        if last is not None and stamp_ns <= last:
            if stamp_ns == last:
                return REPEAT if index == 0 else None
            if stamp_ns > 0 and last - stamp_ns <= self._restart_after:
                return None
        opened = self._pending.get(stamp_ns)
        if opened is None:
            opened = self._pending[stamp_ns] = _Open(len(self.keys))
        if opened.put(index, value):
            return self._complete(stamp_ns, opened.values)
        if len(self._pending) > self._memory:
            del self._pending[next(iter(self._pending))]  # the first that came, in any epoch
        return None

    def missing(self, stamp_ns: int | None = None) -> list[str]:
        """Return the keys that a stamp still waits for; none when it is not waited for.

        Args:
            stamp_ns: The stamp; by default the one that has waited longest.
        """
        if stamp_ns is None:
            opened = next(iter(self._pending.values()), None)
        else:
            opened = self._pending.get(stamp_ns)
        values = [] if opened is None else opened.values
        return [key for key, value in zip(self.keys, values) if value is _MISSING]

    def _complete(self, stamp_ns: int, values: list[Any]) -> tuple[Any, ...]:
        restarted = self.last is not None and stamp_ns < self.last
        self.last = stamp_ns
        if restarted or len(self._pending) == 1:
            # After a restart whatever waits at later stamps is from before it.
            self._pending.clear()
        else:
            self._pending = {t: kept for t, kept in self._pending.items() if t > stamp_ns}
        if restarted and self._on_restart is not None:
            self._on_restart()
        return tuple(values)


class Leaps:
    """Doubts a stamp far ahead of the last one until a second one confirms it.

    One message with a wrong stamp must not take a node ahead, where it would ignore all that comes
    until time has caught up. Far is more than a tenth of a second and twice the last step. Ticks
    that were lost cost one tick more. Stamps that go back are left to `StampMatcher`.
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
        if last is not None and stamp - last > max(_SHORTEST_LEAP, 2 * self._step):
            self._doubted = stamp
            if doubted is None or stamp < doubted:
                return True
        self._step = 0 if last is None else max(0, stamp - last)
        self._last, self._doubted = stamp, None
        return False
