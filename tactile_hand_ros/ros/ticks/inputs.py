# SPDX-License-Identifier: Apache-2.0
"""The inputs of a node: the messages of one tick, joined by stamp.

Every node that answers ticks declares its streams and gets `on_tick(stamp, *values)` when a tick
is complete. Nothing else joins messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from tactile_hand_ros.errors import MessageError, TactileHandError
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks.backlog import Backlog
from tactile_hand_ros.ros.ticks.input_watch import InputWatch
from tactile_hand_ros.ros.ticks.leaps import Leaps
from tactile_hand_ros.ros.ticks.matching import REPEAT, StampMatcher
from tactile_hand_ros.ros.ticks.one_sender import OneSender
from tactile_hand_ros.ros.ticks.streams import Decode, Stream

DAY_NS = 86_400_000_000_000


class TickListener(Protocol):
    """A node that answers ticks.

    With a time-out for silence it also needs `on_blind_tick(stamp, trigger, reason)`, which gets
    the value of the first stream alone when the others are missing.
    """

    @property
    def on_tick(self) -> Callable[..., None]:
        """Answer a tick: takes its stamp [ns] and a value per stream, in their order."""

    def on_repeat(self) -> None:
        """Publish the last answer again."""

    def on_restart(self) -> None:
        """Forget the past: the stamps have started over."""


class TickInputs:
    """Subscribes to streams, joins them by stamp, skips late ticks and watches for silence.

    The first stream is the trigger: when it repeats an answered tick, the last answer is published
    again, and while it continues without the others for a time-out, its values are passed on
    alone and at once, until a complete tick arrives; see `InputWatch`.
    """

    def __init__(
        self,
        node: TactileNode[Any],
        streams: Sequence[Stream],
        listener: TickListener,
        *,
        silence: float | None = None,
        observe: Callable[..., None] | None = None,
    ) -> None:
        """Create the subscriptions.

        Args:
            node: Node that subscribes and reports.
            streams: What a tick consists of; the first is the trigger and has one topic.
            listener: Answers the ticks; in general the node itself.
            silence: Time after which inputs count as missing [s]; None never passes on a tick that
                is not complete.
            observe: Takes what `on_tick` would, for each tick that is skipped, in its turn: for a
                node that has to know every sample although it answers only the newest.
        """
        self._node = node
        self._observe = observe
        self._listener: Any = listener
        self._streams = streams
        topics = [topic for stream in streams if stream.wanted for topic in stream.decoders]
        self._trigger = topics[0]
        self._answer = node.guarded("ticks", self._answer_waiting)
        self._senders = OneSender()
        self._conflict = (
            f"two senders of {self._trigger} publish the same ticks differently; stop one"
        )
        self._backlog: Backlog[tuple[Any, ...]] = Backlog()
        self._matcher = StampMatcher(topics, on_restart=self._restart)
        self._watch = None if silence is None else InputWatch(silence)
        self._reason = ""
        self._answered_blindly = -1
        self._leaps = Leaps()
        for stream in streams:
            for topic, decode in stream.decoders.items() if stream.wanted else ():
                take = partial(self._take, topic, decode)
                node.subscribe(
                    stream.message_type, topic, take, sensor=stream.from_driver, raw=True
                )

    def check_stamp(self, stamp: int) -> None:
        """Check that the stamp [ns] of something for a later tick is not of another clock.

        Raises:
            MessageError: If it is more than a day ahead of the ticks. Before the first tick this
                is not known; check again then.
        """
        last = self._matcher.last
        if last is not None and stamp > last + DAY_NS:
            raise MessageError(far_ahead(stamp, last))

    def report(self) -> None:
        """Put the topics that are missing now into the diagnostics."""
        missing = self._matcher.missing() if self._watch and self._watch.blind else []
        if missing:
            self._complain(missing)

    def _take(self, topic: str, decode: Decode, data: bytes) -> None:
        stamp, value = decode(data)
        if topic == self._trigger and self._is_contested(stamp, data):
            return
        matched = self._matcher.put(topic, stamp, value)
        if matched is REPEAT:
            if not self._backlog:  # else a newer answer is about to be given
                self._listener.on_repeat()
        elif matched is not None:
            self._complete(stamp, matched)
        elif self._watch is not None and topic == self._trigger:
            self._wait(self._watch, stamp, value)

    def _is_contested(self, stamp: int, data: bytes) -> bool:
        """Return whether two senders publish the trigger; which one is right cannot be known.

        Without a trigger the node is silent, and the next one, in the end the driver, holds.
        """
        contested = self._senders.disagree(stamp, data)
        self._node.diagnostics.judge("senders", contested, self._conflict)
        return contested

    def _complete(self, stamp: int, matched: tuple[Any, ...]) -> None:
        if self._watch is not None and self._watch.complete():
            self._node.diagnostics.clear("inputs")
        if stamp > self._answered_blindly:
            self._backlog.put(stamp, matched)
            if len(self._backlog) == 1:
                self._node.after_reading(self._answer)

    def _wait(self, watch: InputWatch, stamp: int, value: Any) -> None:
        was_blind = watch.blind
        if self._leaps.doubts(stamp):
            return
        if watch.triggered(stamp):
            if not was_blind:
                self._complain(self._matcher.missing(stamp))
            self._answered_blindly = stamp
            self._listener.on_blind_tick(stamp, value, self._reason)

    def _complain(self, missing: Sequence[str]) -> None:
        self._reason = f"no {', '.join(missing)}; holding the hand until all inputs are back"
        self._node.diagnostics.fault("inputs", self._reason)

    def _restart(self) -> None:
        self._answered_blindly = -1
        self._backlog.clear()
        self._listener.on_restart()

    def _answer_waiting(self) -> None:
        """Answer what has arrived, without the ticks that a slow node skips."""
        skipped = self._backlog.skipped
        ticks = self._backlog.take()
        if self._backlog.skipped > skipped:
            self._node.diagnostics.value("ticks_left_out", self._backlog.skipped)
        for stamp, matched, is_answered in ticks:
            take = self._listener.on_tick if is_answered else self._observe
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
            if not stream.wanted:
                values.append(None)
            elif stream.per_finger:
                count = len(stream.decoders)
                values.append(np.array(matched[at : at + count]))
                at += count
            else:
                values.append(matched[at])
                at += 1
        return values


def far_ahead(stamp: int, tick: int) -> str:
    """Return what is wrong with a stamp that is more than a day ahead of a tick [ns]."""
    return (
        f"the stamp is {1e-9 * (stamp - tick):.0f} s ahead of the ticks, which are at "
        f"{1e-9 * tick:.3f} s; use their time, or 0 for at once."
    )
