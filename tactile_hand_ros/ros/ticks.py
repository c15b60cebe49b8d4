# SPDX-License-Identifier: Apache-2.0
"""The inputs of a node: the messages of one tick, joined by stamp.

Every node that answers ticks declares its streams and gets `on_tick(stamp, *values)` when a tick
is complete. Nothing else joins messages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.streams import Decode, Stream

_SECOND = 1_000_000_000
_MILLISECOND = 1_000_000
_SHORTEST_LEAP = 100_000_000  # ns; ticks that come in a row are nearer
_HIGHEST = 64  # rank of the first tick


class StampMatcher:
    """Collects one value per key and stamp, and gives the values of a stamp when all are there.

    Sets come in the order of their stamps and never mix stamps. A set that stays incomplete is
    given up when a newer one is complete. A complete set at stamp 0, or more than a second before
    the last one, means that the senders have started over: everything else is forgotten then. A
    single old message means nothing.

    Attributes:
        keys: One key per stream.
        last: The newest complete stamp [ns], None before the first.
        pending: Values of incomplete stamps.
    """

    def __init__(self, keys: Sequence[str], memory: int = 100) -> None:
        """Name the streams.

        Args:
            keys: One key per stream.
            memory: Incomplete stamps that are kept; the first to come are the first to go.
        """
        self.keys = tuple(keys)
        self.last: int | None = None
        self.pending: dict[int, dict[str, Any]] = {}
        self._memory = memory

    def put(self, key: str, stamp_ns: int, value: Any) -> tuple[Any, ...] | None:
        """Add a value.

        Args:
            key: Stream of the value.
            stamp_ns: Its tick [ns].
            value: The value; a later one of the same tick replaces it.

        Returns:
            All values of the tick in the order of the keys when this one made it complete.
        """
        last = self.last
        is_old = last is not None and 0 < stamp_ns <= last and last - stamp_ns <= _SECOND
        if is_old or stamp_ns == last:
            return None
        values = self.pending.setdefault(stamp_ns, {})
        values[key] = value
        if len(values) == len(self.keys):
            has_restarted = last is not None and stamp_ns < last
            # After a restart whatever waits at later stamps is from before it.
            waiting = {} if has_restarted else self.pending
            self.pending = {t: kept for t, kept in waiting.items() if t > stamp_ns}
            self.last = stamp_ns
            return tuple([values[key] for key in self.keys])
        if len(self.pending) > self._memory:
            del self.pending[next(iter(self.pending))]  # the first that came, in any epoch
        return None

    def missing(self, stamp_ns: int) -> list[str]:
        """Return the keys that a stamp [ns] still waits for; none when it is not waited for."""
        values = self.pending.get(stamp_ns)
        return [] if values is None else [key for key in self.keys if key not in values]


_NUMBER = "publication_sequence_number"

_LASTING = 0.5
"""Time after which one fall of the numbers, and a conflict, are over [s]."""


def two_senders(topic: str) -> str:
    """Return what is wrong when two publishers send on a topic."""
    return f"two senders of {topic}; stop one of them (two hands need two namespaces)"


class SenderCheck:
    """Finds two publishers of a topic by the sequence numbers of their messages.

    The middleware numbers the messages of each publisher 1, 2, 3, ... From one publisher the
    numbers rise. A successor of one that was killed starts again at 1, so they fall once. Where two
    send in turn, the numbers fall again and again. The number of publishers does not show it: a
    publisher that was killed counts for ten seconds more, and its successor must be let in before.
    Where the middleware gives no numbers, nothing is found.

    Attributes:
        conflicts: How many messages showed a second sender.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without messages.

        Args:
            clock: Time [s].
        """
        self._clock = clock
        self._last = 0
        self._fell: float | None = None
        self._found: float | None = None
        self.conflicts = 0

    def note(self, info: Mapping[str, Any]) -> bool:
        """Note what the middleware reports about a message; return whether two senders send."""
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


def rank(stamp_ns: int, previous_ns: int | None) -> int:
    """Return the rank of a tick after another one [ns]; without one it is the highest."""
    if previous_ns is None:
        return _HIGHEST
    return (stamp_ns // _MILLISECOND ^ previous_ns // _MILLISECOND).bit_length() - 1


def chosen(stamps: Sequence[int], previous: int | None) -> list[int]:
    """Return which of several complete ticks are answered; the others are skipped.

    A node that is slower than its ticks and answers all of them answers ever older ones. This
    cannot happen in lockstep, but it can in real time. So of several ticks that wait together some
    are skipped. But a consumer that needs the answers of two nodes to the same tick gets neither
    if each node skips other ticks. Each tick therefore has a rank: n where it is the first one in
    a stretch of 2^n ms but not of 2^(n+1) ms. It is skipped only where one of higher rank waits
    behind it. That one comes no sooner than 2^n ms less one period later, so no node that lags by
    less skips it, and all nodes meet again and again, however they lag.

    Args:
        stamps: What waits, oldest first [ns].
        previous: The tick before them [ns], None if there was none.
    """
    ranks = [
        rank(stamp, before) for stamp, before in zip(stamps, [previous, *stamps], strict=False)
    ]
    kept: list[int] = []
    highest = -1
    for stamp, own in zip(reversed(stamps), reversed(ranks), strict=True):
        if own >= highest:
            highest = own
            kept.append(stamp)
    return kept[::-1]


class TickInputs:
    """Subscribes to streams, joins them by stamp, skips late ticks and watches for silence.

    The first stream is the trigger. When it repeats an answered tick, the last answer is published
    again. A trigger far ahead, by more than a tenth of a second and twice the last step, is ignored
    until a second one confirms it: one wrong stamp must not take a node ahead, where it would
    ignore all that comes. While two publishers send it, no tick is answered: which one is right
    cannot be known, and the driver holds.

    While the trigger continues without the others for a time-out, its values are passed on alone
    and immediately, until a complete tick arrives. Silence of the trigger itself does not count:
    then there is nothing to answer. The time must have passed by the stamps and by the wall clock.
    By the stamps, because in lockstep they do not advance while a tick waits for its inputs: all
    nodes wait for the one that stalls, and no result depends on how fast the machine is. By the
    wall clock, because one stamp that lies ahead does not mean that time has passed.
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
        """Create the subscriptions.

        Args:
            node: Node that subscribes and reports.
            streams: What a tick consists of; the first is the trigger and has one topic.
            listener: In general the node. Has `on_tick(stamp, *values)`, which answers a tick [ns],
                `on_repeat()`, which publishes the last answer again, `on_restart()` for stamps that
                start over and, with `silence`, `on_blind_tick(stamp, trigger, reason)`, which gets
                the value of the first stream alone.
            silence: Time after which inputs count as missing [s]; None never passes on a tick that
                is not complete.
            observe: Takes what `on_tick` would, for each tick that is skipped, in its turn: for a
                node that has to process every sample although it answers only the newest.
            clock: Wall clock [ns].
        """
        self._node, self._listener, self._observe = node, listener, observe
        self._streams, self._clock = streams, clock
        self._timeout = math.inf if silence is None else 1e9 * silence
        topics = [topic for stream in streams for topic in stream.decoders]
        self._trigger = topics[0]
        self._answer = node.guarded("ticks", self._answer_waiting)
        self._senders = SenderCheck()
        self._matcher = StampMatcher(topics)
        self._newest: int | None = None  # trigger [ns], and one ahead of it that is not confirmed
        self._ahead: int | None = None
        self._step = 0  # between the last two triggers [ns]
        self._waiting: dict[int, tuple[Any, ...]] = {}  # complete, until all that is here is read
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
        was_contested, contested = self._senders.in_conflict, self._senders.note(info)
        if contested or was_contested:
            self._node.diagnostics.judge("senders", contested, two_senders(self._trigger))
        if contested or self._is_unconfirmed(stamp):
            return
        if stamp == self._matcher.last:  # answered, but the answer has not arrived
            if not self._waiting:  # else a newer answer is about to be given
                self._listener.on_repeat()
        elif not self._match(self._trigger, stamp, value) and self._matcher.missing(stamp):
            self._note_alone(stamp, value)

    def _is_unconfirmed(self, stamp: int) -> bool:
        """Return whether a trigger [ns] is far ahead and confirms none that was so before."""
        newest, ahead = self._newest, self._ahead
        passed = 0 if newest is None else stamp - newest
        if passed > max(_SHORTEST_LEAP, 2 * self._step) and (ahead is None or stamp < ahead):
            self._ahead = stamp
            return True
        self._newest, self._ahead, self._step = stamp, None, max(0, passed)
        return False

    def _match(self, topic: str, stamp: int, value: Any) -> bool:
        """Add a value to its tick [ns]; return whether that made it complete."""
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
        """Answer when all that has arrived is read; immediately where that is not known."""
        wait = getattr(self._node.executor, "after_reading", None)
        if wait is None:
            self._answer()
        else:
            wait(self._answer)

    def _note_alone(self, stamp: int, value: Any) -> None:
        """Pass on a trigger alone where the others have been missing for the time-out."""
        if not self._reason:
            now = self._clock()
            if self._alone_since is None or stamp < self._alone_since[1]:
                self._alone_since = now, stamp
            since, first = self._alone_since
            if min(now - since, stamp - first) < self._timeout:
                return
            oldest = next(iter(self._matcher.pending))  # of the newest, nothing is here yet
            missing = ", ".join(self._matcher.missing(oldest))
            self._reason = f"no {missing}; holding the hand until all inputs are back"
            self._node.diagnostics.fault("inputs", self._reason)
        self._answered_blindly = stamp
        self._listener.on_blind_tick(stamp, value, self._reason)

    def _answer_waiting(self) -> None:
        """Answer what has arrived, without the ticks that a slow node skips."""
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

    def _values(self, matched: tuple[Any, ...]) -> list[Any]:
        """Return one value per stream."""
        values: list[Any] = []
        at = 0
        for stream in self._streams:
            if stream.per_finger:
                count = len(stream.decoders)
                values.append(np.array(matched[at : at + count]))
                at += count
            else:
                values.append(matched[at])
                at += 1
        return values
