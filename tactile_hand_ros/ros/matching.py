# SPDX-License-Identifier: Apache-2.0
"""Brings together the messages of one tick, whatever order they arrive in."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, Final, Literal

_SECOND = 1_000_000_000


class Repeat(enum.Enum):
    """Type of `REPEAT`."""

    REPEAT = enum.auto()


REPEAT: Final = Repeat.REPEAT
"""The tick was answered already: publish the last answer again."""

_MISSING: Final = object()


class StampMatcher:
    """Collects one value per key and stamp, and gives the values of a stamp when all are there.

    Sets come in the order of their stamps and never mix stamps. A set that stays incomplete is
    given up when a newer one is complete. After a jump back of more than ``restart_after_ns``
    the sender has begun anew, and so does the matcher.
    """

    def __init__(
        self,
        keys: Sequence[str],
        *,
        memory: int = 100,
        restart_after_ns: int = _SECOND,
    ) -> None:
        """Name the streams.

        Args:
            keys: One key per stream; the first is the one whose repetition means that the tick
                is asked for again.
            memory: Incomplete stamps that are kept; the oldest go first.
            restart_after_ns: Jump back in time that means a restart [ns].
        """
        self.keys = tuple(keys)
        self._index = {key: index for index, key in enumerate(self.keys)}
        self._memory = memory
        self._restart_after = restart_after_ns
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.last: int | None = None
        self._pending: dict[int, list[Any]] = {}

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
            if last - stamp_ns <= self._restart_after:
                return REPEAT if stamp_ns == last and index == 0 else None
            self.reset()
        values = self._pending.get(stamp_ns)
        if values is None:
            values = self._pending[stamp_ns] = [_MISSING] * len(self.keys)
        values[index] = value
        if _MISSING not in values:
            return self._complete(stamp_ns, values)
        if len(self._pending) > self._memory:
            del self._pending[min(self._pending)]
        return None

    def _complete(self, stamp_ns: int, values: list[Any]) -> tuple[Any, ...]:
        self.last = stamp_ns
        if len(self._pending) == 1:
            self._pending.clear()
        else:
            self._pending = {t: kept for t, kept in self._pending.items() if t > stamp_ns}
        return tuple(values)
