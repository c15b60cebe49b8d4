# SPDX-License-Identifier: Apache-2.0
"""Notices that two senders publish the same ticks."""

from __future__ import annotations

from collections import OrderedDict

_MEMORY = 256
"""Ticks whose messages are remembered."""

_LASTING_NS = 500_000_000
"""Time by the stamps without another disagreement after which it is over [ns]."""


class OneSender:
    """Compares the messages of each tick: one sender repeats a tick to the byte."""

    def __init__(self) -> None:
        """Start without messages."""
        self._first: OrderedDict[int, bytes] = OrderedDict()
        self._until: int | None = None
        self._last = 0

    def disagree(self, stamp: int, data: bytes) -> bool:
        """Note a message and return whether two senders disagree or did so just before.

        Args:
            stamp: Its tick, ns; 0 means that time starts over.
            data: The serialized message.
        """
        if stamp == 0 and self._last > 0:
            self._first.clear()
            self._until = None
        self._last = stamp
        if self._first.setdefault(stamp, data) != data:
            self._until = stamp + _LASTING_NS
        if len(self._first) > _MEMORY:
            self._first.popitem(last=False)
        if self._until is not None and stamp > self._until:
            self._until = None
        return self._until is not None
