# SPDX-License-Identifier: Apache-2.0
"""Which ticks were late, and why.

A tick is in time when its command arrives before the next tick is due. It is late when the command
arrives later or not at all, and skipped when it comes due together with a later one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from tactile_hand_ros import names
from tactile_hand_ros.ros.realtime.causes import CAUSES, TickWatch


class Deadlines:
    """Counts ticks and their causes; each tick is judged once.

    Attributes:
        late: Ticks whose command was late or never came.
        skipped: Ticks that came due together with a later one.
        in_time: Ticks whose command was in time.
    """

    def __init__(self, watch: TickWatch, *, awaits_others: bool) -> None:
        """Start.

        Args:
            watch: Explains how the time since a tick was spent.
            awaits_others: Whether nodes in other processes take part in the answer to a tick.
        """
        self._watch = watch
        self._awaits_others = awaits_others
        self.late = self.skipped = self.in_time = 0
        self._causes: Counter[str] = Counter()
        self._is_open = False

    @property
    def causes(self) -> dict[str, int]:
        """How many ticks were late or skipped, by cause."""
        return {cause: self._causes[cause] for cause in CAUSES if self._causes[cause]}

    def begin(self) -> None:
        """Begin with a tick that is published now."""
        self._is_open = True
        self._watch.begin(0.0)

    def due(self, ticks: int, behind_ns: int) -> None:
        """Begin with the newest of so many ticks that are due now.

        The tick before them has had its time, and all but the newest are skipped.

        Args:
            ticks: How many.
            behind_ns: How long ago the first of them came due [ns].
        """
        cause = self._judge_late() if self._is_open else ""
        self._watch.begin(1e-9 * behind_ns)
        if ticks > 1:
            self.skipped += ticks - 1
            self._causes[cause or self._watch.cause_before()] += ticks - 1
        self._is_open = True

    def answered(self, overdue_ns: int) -> None:
        """Note that the command for the newest tick has arrived.

        Args:
            overdue_ns: How long ago the next tick came due [ns], negative if it will.
        """
        if not self._is_open:
            return
        if overdue_ns > 0:
            self._judge_late()
        else:
            self.in_time += 1
            self._is_open = False
        self._watch.end(in_time=overdue_ns <= 0)

    def forget(self) -> None:
        """Expect no command for the newest tick: time has been stopped."""
        self._is_open = False

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report counters, each as key and value."""
        put("late_commands", self.late)
        for cause, count in self.causes.items():
            put(f"{names.LATE_FOR}{cause}", count)

    def _judge_late(self) -> str:
        cause = self._watch.cause(awaits_others=self._awaits_others)
        self.late += 1
        self._causes[cause] += 1
        self._is_open = False
        return cause
