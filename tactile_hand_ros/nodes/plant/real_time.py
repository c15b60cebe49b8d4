# SPDX-License-Identifier: Apache-2.0
"""What the plant watches while it follows the wall clock: deadlines, their causes, and headroom."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

from tactile_hand_ros import names
from tactile_hand_ros.nodes.plant.deadlines import Deadlines
from tactile_hand_ros.nodes.plant.headroom import Headroom
from tactile_hand_ros.nodes.plant.pacing import Pace
from tactile_hand_ros.ros.diagnostics import WARN
from tactile_hand_ros.ros.direct.delivery import direct_delivery
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.realtime.between_ticks import between_ticks
from tactile_hand_ros.ros.realtime.causes import GARBAGE, TickWatch
from tactile_hand_ros.ros.realtime.garbage import CollectionClock


class RealTime:
    """Judges the ticks of a plant in real time, and says once when the computer is too slow.

    Without real time every method does nothing.
    """

    def __init__(self, node: TactileNode[Any], pace: Pace, *, is_used: bool) -> None:
        """Prepare.

        Args:
            node: The plant.
            pace: Says when ticks are due.
            is_used: Whether the plant follows the wall clock.
        """
        self._node, self._pace = node, pace
        self._is_used = is_used
        self._between = between_ticks(node.context)
        self._collections = CollectionClock() if is_used else None
        is_alone = direct_delivery(node.context) is None
        spent = self._between.spent
        timed = {cause: partial(spent.__getitem__, cause) for cause in spent}
        if self._collections is not None:
            collections = self._collections
            timed[GARBAGE] = partial(getattr, collections, "seconds")
        self._watch = TickWatch(timed, 1.0 / node.config.rate)
        self._deadlines = Deadlines(self._watch, awaits_others=is_alone)
        self._headroom = Headroom(node.config.rate, node.config.time_step)
        self._advice = _advice(is_alone=is_alone)
        self._has_complained = False

    def start(self) -> None:
        """Begin with a tick that is published now."""
        if self._is_used:
            self._headroom.restart(self._deadlines.in_time, self._pace.ages.count)
            self._deadlines.begin()

    def stop(self) -> None:
        """Note that time stands still."""
        self._deadlines.forget()
        self._between.rest()

    def due(self, ticks: int) -> None:
        """Begin with the newest of so many ticks that are due now."""
        if self._is_used:
            self._deadlines.due(ticks, self._pace.behind_ns)

    def answered(self) -> None:
        """Note that the command for the newest tick has arrived."""
        if self._is_used:
            self._deadlines.answered(self._pace.overdue_ns)
            self._between.tick_done(by_plant=True)

    def close(self) -> None:
        """Let go of what counts."""
        self._watch.close()
        if self._collections is not None:
            self._collections.close()

    def report(self, put: Callable[[str, object], None]) -> None:
        """Report counters and causes, and say in words when the computer is too slow."""
        self._deadlines.report(put)
        if self._is_used:
            put("in_time_ticks", self._deadlines.in_time)
            self._between.garbage.report(put)
            self._judge_headroom()

    def _judge_headroom(self) -> None:
        text = self._headroom.judge(self._deadlines.in_time, self._pace.ages.count, self._advice)
        self._node.diagnostics.judge(names.TOO_SLOW, bool(text), text, WARN)
        if not text:
            return
        self._node.diagnostics.value(names.TOO_SLOW, text)
        if not self._has_complained:
            self._has_complained = True
            self._node.get_logger().warning(text)


def _advice(*, is_alone: bool) -> str:
    """Return what helps besides a lower rate."""
    if is_alone:
        return "run the nodes in one process (composed)"
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        return "end other programs"
    return "run the nodes with --priority 50"
