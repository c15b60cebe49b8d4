# SPDX-License-Identifier: Apache-2.0
"""The options of a replay, and its progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ReplayOptions:
    """How a bag is replayed.

    Attributes:
        rate: Seconds of the bag per second on the wall.
        start_offset: Where to begin, s after the first message.
        loop: Begin again at the end, until stopped; a round takes at least 0.1 s.
        topics: Regular expressions, one of which matches the whole name of a chosen topic.
        exclude: Regular expressions, none of which matches it.
        clock: Messages on ``/clock`` per second with the time of the bag, 0 for none; those of the
            bag are left out then.
        namespace: Put before all names of topics.
        paused: Begin paused.
        delay: Wait on the wall before the first message, s.
    """

    rate: float = 1.0
    start_offset: float = 0.0
    loop: bool = False
    topics: Sequence[str] = (".*",)
    exclude: Sequence[str] = ()
    clock: float = 0.0
    namespace: str = ""
    paused: bool = False
    delay: float = 0.0


@dataclass
class ReplayProgress:
    """Where a replay is.

    Attributes:
        position: Time in the bag, s after its first message.
        duration: Length of the bag, s.
        messages: Number of messages published.
        paused: Whether it stands still.
        late: Longest delay of a message behind its time, s.
    """

    position: float = 0.0
    duration: float = 0.0
    messages: int = 0
    paused: bool = False
    late: float = 0.0
