# SPDX-License-Identifier: Apache-2.0
"""The inputs of a node: the messages of one tick, joined by timestamp.

Every node that answers ticks declares its streams and gets `on_tick(stamp, *values)` when a tick is
complete. No other code joins messages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from tactile_hand_ros.cdr import is_reset
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.streams import Decode, Stream

_MILLISECOND = 1_000_000
_SHORTEST_LEAP = 100_000_000  # ns; consecutive ticks are closer
_HIGHEST = 64  # rank of the first tick


class StampMatcher:
    """Collects one value per key and timestamp, and returns complete sets in order of timestamps.

    An incomplete set is dropped when a newer one is complete. A complete set at timestamp 0, or
    more than a second before the last one, means that the senders have restarted; all other sets
    are then dropped. A single old message has no effect.

    Attributes:
        keys: One key per stream.
        last: The newest complete timestamp [ns], None before the first.
        pending: Values of incomplete timestamps.
    """

    def __init__(self, keys: Sequence[str], memory: int = 100) -> None:
        """Set the keys, and the number of incomplete timestamps to keep, oldest dropped first."""
        self.keys = tuple(keys)
        self.last: int | None = None
        self.pending: dict[int, dict[str, Any]] = {}
        self._memory = memory

    def put(self, key: str, stamp_ns: int, value: Any) -> tuple[Any, ...] | None:
        """Add a value of a tick [ns], replacing an earlier one.

        Return all values of the tick in the order of the keys if it is now complete, else None.
        """
        last = self.last
        if stamp_ns == last or self.lateness(stamp_ns):
            return None
        values = self.pending.setdefault(stamp_ns, {})
        values[key] = value
        if len(values) == len(self.keys):
            has_restarted = last is not None and stamp_ns < last
            # After a restart, all later pending timestamps date from before it.
            waiting = {} if has_restarted else self.pending
            self.pending = {t: kept for t, kept in waiting.items() if t > stamp_ns}
            self.last = stamp_ns
            return tuple([values[key] for key in self.keys])
        if len(self.pending) > self._memory:
            del self.pending[next(iter(self.pending))]  # the first to arrive
        return None

    def lateness(self, stamp_ns: int) -> int:
        """Return how long a tick [ns] is before the last one [ns]; 0 for a new one or a restart."""
        if self.last is None or stamp_ns > self.last or is_reset(self.last, stamp_ns):
            return 0
        return self.last - stamp_ns

    def rarest(self) -> list[str]:
        """Return the keys that fewest pending timestamps have, or one more than that.

        A sender that died while it sent has one more of what it sends first, and one that is slow
        has more than one that is silent.
        """
        counts = [sum(key in values for values in self.pending.values()) for key in self.keys]
        limit = min(min(counts) + 1, max(counts) - 1)
        return [key for key, count in zip(self.keys, counts, strict=True) if count <= limit]


_NUMBER = "publication_sequence_number"
_LASTING = 0.5  # s, after which a drop of the sequence numbers, or a conflict, is forgotten


def two_senders(topic: str) -> str:
    """Return the error text for two publishers on a topic."""
    return f"two senders of {topic}; stop one of them (two hands need two namespaces)"


class SenderCheck:
    """Detects two publishers on a topic by the sequence numbers of their messages.

    The middleware numbers the messages of each publisher 1, 2, 3, ... With one publisher the
    numbers rise. The successor of a killed publisher restarts at 1, so they drop once. With two
    publishers they drop again and again. Counting publishers does not work: a killed publisher
    counts for ten more seconds, and its successor must be accepted earlier. Without sequence
    numbers from the middleware, nothing is detected.

    Attributes:
        conflicts: Number of messages that revealed a second sender.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without messages; `clock` is in seconds."""
        self._clock = clock
        self._last = 0
        self._fell: float | None = None
        self._found: float | None = None
        self.conflicts = 0

    def note(self, info: Mapping[str, Any]) -> bool:
        """Check the middleware's info on a message; return whether there are two senders."""
        number = info.get(_NUMBER)
        if number is None:
            return False
        if number <= self._last:
            now = self._clock()
            if self._fell is not None and now - self._fell < _LASTING:
                self._found = now
                self.conflicts += 1
            self._fell = now
        self._last = number
        return self.in_conflict

    @property
    def in_conflict(self) -> bool:
        """Whether a second sender was found within the last half second."""
        return self._found is not None and self._clock() - self._found < _LASTING


def chosen(stamps: Sequence[int], previous: int | None) -> list[int]:
    """Return which of several complete ticks [ns], oldest first, to answer; the others are skipped.

    A node that is slower than its ticks would lag ever further if it answered all of them. This
    cannot happen in lockstep, but it can in real time. So if several ticks wait, some are skipped.
    If each node skipped different ticks, a consumer that needs the answers of two nodes to the same
    tick would get neither. Each tick therefore has a rank: n if it is the first in a window of
    2^n ms but not of 2^(n+1) ms. It is skipped only if a tick of higher rank waits behind it. That
    tick comes at least 2^n ms minus one period later, so a node that lags less does not skip it.
    All nodes therefore regularly answer the same ticks, regardless of their lag.
    """
    kept: list[int] = []
    highest = -1
    for stamp, before in reversed(list(zip(stamps, [previous, *stamps], strict=False))):
        rank = _HIGHEST
        if before is not None:
            rank = (stamp // _MILLISECOND ^ before // _MILLISECOND).bit_length() - 1
        if rank >= highest:
            highest = rank
            kept.append(stamp)
    return kept[::-1]


class TickInputs:
    """Subscribes to streams, joins them by timestamp, skips late ticks and detects silence.

    The first stream is the trigger. If it repeats an answered tick, the last answer is published
    again. A trigger that leaps ahead by more than 0.1 s and twice the last step is ignored until a
    second one confirms it; otherwise one wrong timestamp would make the node ignore all later
    messages. While two publishers send the trigger, no tick is answered, because neither can be
    trusted; the driver holds.

    If the trigger continues without the other streams for the timeout, its values are passed on
    alone, immediately, until a complete tick arrives. Silence of the trigger itself does not count,
    because there is no tick to answer. The timeout must pass both in timestamps and on the wall
    clock. In lockstep, timestamps do not advance while a tick waits for its inputs, so all nodes
    wait for a stalled one and no result depends on the machine's speed. The wall clock guards
    against a single timestamp that is too far ahead.
    """

    def __init__(
        self,
        node: TactileNode[Any],
        streams: Sequence[Stream],
        listener: Any,
        *,
        silence: float | None = None,
        observe: Callable[..., None] | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Create the subscriptions; the first stream is the trigger and has one topic.

        Args:
            node: Node that subscribes and reports.
            streams: Streams of a tick.
            listener: Usually the node. Has `on_tick(stamp, *values)` to answer a tick [ns],
                `on_repeat()`, `on_restart()` for timestamps that start over and, with `silence`,
                `on_blind_tick(stamp, trigger, reason)`.
            silence: Timeout of missing inputs [s]; None never passes on an incomplete tick.
            observe: Called like `on_tick`, in order, for each skipped tick, for a node that must
                process every sample.
            clock: Wall clock [ns].
        """
        self._node, self._listener, self._observe = node, listener, observe
        self._streams, self._clock = streams, clock
        self._timeout = math.inf if silence is None else 1e9 * silence
        topics = [topic for stream in streams for topic in stream.decoders]
        self._trigger = topics[0]
        self._answer = node.guarded("ticks", self._answer_waiting)
        self._senders, self._contested = SenderCheck(lambda: 1e-9 * clock()), False
        node.diagnostics.expects = self._trigger
        self._matcher = StampMatcher(topics)
        self._newest: int | None = None  # trigger [ns], and an unconfirmed one ahead of it
        self._ahead: int | None = None
        self._step = 0  # between the last two triggers [ns]
        self._waiting: dict[int, tuple[Any, ...]] = {}  # complete, until all messages are read
        self._previous: int | None = None  # newest tick that was answered [ns]
        self._skipped = 0
        self._alone_since: tuple[int, int] | None = None  # wall clock and stamp [ns]
        self._reason = ""  # why ticks are answered blindly, empty while they are not
        self._answered_blindly = -1
        for stream in streams:
            for topic, decode in stream.decoders.items():
                take: Any = partial(self._take, topic, decode)
                if topic == self._trigger:
                    take = partial(self._take_trigger, decode)
                node.subscribe(
                    stream.message_type, topic, take, sensor=stream.from_driver, raw=True
                )

    def _take(self, topic: str, decode: Decode, data: bytes) -> None:
        stamp, value = decode(data)
        self._match(topic, stamp, value)

    def _take_trigger(self, decode: Decode, data: bytes, info: Mapping[str, Any]) -> None:
        stamp, value = decode(data)
        was_contested, contested = self._contested, self._senders.note(info)
        self._contested = contested
        if contested or was_contested:
            self._node.diagnostics.judge("senders", contested, two_senders(self._trigger))
        if contested:
            return
        # First, or the tick after a late one would seem to leap ahead.
        if late := 1e-9 * self._matcher.lateness(stamp):
            self._node.reject(
                self._trigger, f"its timestamp is {late:.3g} s before the last tick; it is ignored"
            )
        elif self._is_unconfirmed(stamp):
            return
        elif stamp == self._matcher.last:  # already answered; the answer may be lost
            if not self._waiting:  # else a newer answer follows
                self._listener.on_repeat()
        elif not self._match(self._trigger, stamp, value) and stamp in self._matcher.pending:
            self._note_alone(stamp, value)

    def _is_unconfirmed(self, stamp: int) -> bool:
        """Return whether a trigger [ns] is far ahead without confirming an earlier one."""
        newest, ahead = self._newest, self._ahead
        passed = 0 if newest is None else stamp - newest
        if passed > max(_SHORTEST_LEAP, 2 * self._step) and (ahead is None or stamp < ahead):
            self._ahead = stamp
            return True
        self._newest, self._ahead, self._step = stamp, None, max(0, passed)
        return False

    def _match(self, topic: str, stamp: int, value: Any) -> bool:
        """Add a value to its tick [ns]; return whether the tick is now complete."""
        last = self._matcher.last
        values = self._matcher.put(topic, stamp, value)
        if values is None:
            return False
        if last is not None and stamp < last:
            self._waiting, self._previous, self._answered_blindly = {}, None, -1
            self._listener.on_restart()
        self._alone_since = None
        if self._reason:
            self._reason = ""
            self._node.diagnostics.clear("inputs")
        if stamp > self._answered_blindly:
            self._waiting[stamp] = values
            if len(self._waiting) == 1:
                self._after_reading()
        return True

    def _after_reading(self) -> None:
        """Answer when all waiting messages are read; immediately with executors of rclpy."""
        wait = getattr(self._node.executor, "after_reading", None)
        if wait is None:
            self._answer()
        else:
            wait(self._answer)

    def _note_alone(self, stamp: int, value: Any) -> None:
        """Pass on a trigger alone if the other inputs have been missing for the timeout."""
        if not self._reason:
            now = self._clock()
            if self._alone_since is None or stamp < self._alone_since[1]:
                self._alone_since = now, stamp
            since, first = self._alone_since
            if min(now - since, stamp - first) < self._timeout:
                return
            missing = ", ".join(self._matcher.rarest())
            self._reason = f"no {missing}; holding the hand until all inputs are back"
            self._node.diagnostics.fault("inputs", self._reason)
        self._answered_blindly = stamp
        self._listener.on_blind_tick(stamp, value, self._reason)

    def _answer_waiting(self) -> None:
        """Answer the complete ticks, except those that a slow node skips."""
        waiting, self._waiting = self._waiting, {}
        answered = set(waiting if len(waiting) < 2 else chosen(list(waiting), self._previous))
        self._previous = max(answered, default=self._previous)
        if len(answered) < len(waiting):
            self._skipped += len(waiting) - len(answered)
            self._node.diagnostics.value("ticks_left_out", self._skipped)
        for stamp, matched in waiting.items():
            take = self._listener.on_tick if stamp in answered else self._observe
            if take is None:
                continue
            try:
                take(stamp, *self._values(matched))
            except TactileHandError as error:
                self._node.reject(self._trigger, error)
            except Exception as error:  # the ticks behind it must still be answered
                self._node.survive("ticks", error)

    def _values(self, matched: tuple[Any, ...]) -> list[Any]:
        """Return one value per stream."""
        given = iter(matched)
        return [
            np.array([next(given) for _ in stream.decoders]) if stream.per_finger else next(given)
            for stream in self._streams
        ]
