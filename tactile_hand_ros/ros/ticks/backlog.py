# SPDX-License-Identifier: Apache-2.0
"""What a node answers when it has fallen behind: so much that others can go on, and the newest.

A node that is slower than its ticks, and answers all of them, answers ever older ones. In lockstep
that cannot be, in real time it can. So of several ticks that wait together some are left out. But
who needs the answers of two nodes to one tick gets nothing if each leaves out other ticks. Each
tick therefore has a rank, n where it is the first one in a stretch of 2^n ms but not of 2^(n+1) ms,
and is left out only where one of higher rank waits behind it. That one comes no sooner than 2^n ms
less one period later: no node that lags by less leaves it out, and so all nodes meet again and
again, however they lag.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.node import TactileNode

T = TypeVar("T")

_MILLISECOND = 1_000_000
_HIGHEST = 64


def rank(stamp_ns: int, previous_ns: int | None) -> int:
    """Return the rank of a tick after another one [ns]; without one it is the highest."""
    if previous_ns is None:
        return _HIGHEST
    return (stamp_ns // _MILLISECOND ^ previous_ns // _MILLISECOND).bit_length() - 1


def chosen(stamps: Sequence[int], previous: int | None) -> list[int]:
    """Return those of waiting ticks which nothing of higher rank follows.

    Args:
        stamps: What waits, oldest first [ns].
        previous: The tick before them [ns], None if there was none.
    """
    ranks = [rank(stamp, before) for stamp, before in zip(stamps, [previous, *stamps])]
    kept: list[int] = []
    highest = -1
    for stamp, own in zip(reversed(stamps), reversed(ranks), strict=True):
        if own >= highest:
            highest = own
            kept.append(stamp)
    return kept[::-1]


class Backlog(Generic[T]):
    """Complete ticks, answered when everything that has arrived is read."""

    def __init__(
        self, node: TactileNode[Any], topic: str, answer: Callable[[int, T], None]
    ) -> None:
        """Start empty.

        Args:
            node: Reads the messages, and reports how many ticks were left out.
            topic: Named where an answer fails.
            answer: Takes a tick [ns] and what was heard of it.
        """
        self._node = node
        self._topic = topic
        self._answer = answer
        self.clear()
        self._left_out = 0

    def put(self, stamp_ns: int, heard: T) -> None:
        """Answer a tick soon."""
        self._waiting[stamp_ns] = heard
        if len(self._waiting) == 1:
            self._node.after_reading(self._work)

    def repeat(self, answer: Callable[[], None]) -> None:
        """Give the last answer again, unless a newer one is about to be given."""
        if not self._waiting:
            answer()

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting: dict[int, T] = {}
        self._previous: int | None = None

    def _work(self) -> None:
        waiting, self._waiting = self._waiting, {}
        stamps = list(waiting)
        if len(stamps) > 1:
            stamps = chosen(stamps, self._previous)
        if len(stamps) < len(waiting):
            self._left_out += len(waiting) - len(stamps)
            self._node.diagnostics.value("ticks_left_out", self._left_out)
        for stamp in stamps:
            self._previous = stamp
            try:
                self._answer(stamp, waiting[stamp])
            except TactileHandError as error:
                self._node.reject(self._topic, error)
