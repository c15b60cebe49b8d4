# SPDX-License-Identifier: Apache-2.0
"""How a process runs: with SCHED_FIFO where the command line asks for it.

What the system does not permit does not stop the node: it runs as before and reports it in its
diagnostics.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics

PRIORITY = "--priority"
USAGE = f"{PRIORITY} N (SCHED_FIFO, 1 to 99)"

_POLICIES = {
    number: name
    for name in ("SCHED_OTHER", "SCHED_FIFO", "SCHED_RR", "SCHED_BATCH", "SCHED_IDLE")
    if (number := getattr(os, name, None)) is not None
}
_HIGHEST = 99
_RESENDING = "dds.asyn"
"""What names of Fast DDS's threads start with that send again what a subscriber missed."""

_refusals: list[str] = []


@dataclass(frozen=True)
class Scheduling:
    """What is asked of the kernel.

    Attributes:
        priority: Priority among SCHED_FIFO processes, 1 to 99; 0 leaves the policy as it is.
    """

    priority: int = 0

    @property
    def arguments(self) -> list[str]:
        """The words that ask an executable for it."""
        return [PRIORITY, str(self.priority)] if self.priority else []

    def raise_priority(self) -> None:
        """Set the priority of all threads that there are, when all nodes have been made.

        Not earlier: what a start takes, and a process that it starts, must not keep others waiting.
        """
        _refusals.clear()
        if not self.priority:
            return
        try:
            for thread in _threads():
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(self.priority))
        except OSError as error:
            advice = "run as root, or allow rtprio in limits.conf"
            _refusals.append(f"{PRIORITY} {self.priority} was refused ({error.strerror}): {advice}")
        yield_while_resending()


def yield_while_resending() -> None:
    """Give threads that send lost messages again the lowest priority among SCHED_FIFO.

    Such a thread asks in a loop, without sleeping, until the thread that publishes has taken a
    message back. Two threads with the same priority never make way for each other: on two
    processors, two of them stopped two runs for good within minutes.
    """
    for thread in _threads():
        with contextlib.suppress(OSError):  # it has ended, or was never real-time
            is_real_time = os.sched_getscheduler(thread) == os.SCHED_FIFO
            if is_real_time and _thread_name(thread).startswith(_RESENDING):
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(1))


def take_scheduling(words: Sequence[str]) -> tuple[Scheduling, list[str]]:
    """Read the option out of a command line.

    Args:
        words: Arguments without those of ROS.

    Returns:
        What is asked for, and the words that are left.

    Raises:
        ConfigurationError: If the value is missing or not allowed.
    """
    left, text = [], "0"
    rest = iter(words)
    for word in rest:
        name, equals, value = word.partition("=")
        if name == PRIORITY:
            text = value if equals else next(rest, "")
        else:
            left.append(word)
    return Scheduling(parse_priority(text)), left


def parse_priority(text: str) -> int:
    """Read a priority.

    Raises:
        ConfigurationError: If it is not an integer from 0 to 99.
    """
    if not text.isdecimal() or int(text) > _HIGHEST:
        raise ConfigurationError(
            f"{PRIORITY} is '{text}', expected a whole number from 1 to {_HIGHEST}, or 0 for"
            " ordinary scheduling."
        )
    return int(text)


def report_scheduling(diagnostics: Diagnostics) -> None:
    """Put policy and priority in force into diagnostics, and what was refused."""
    number = os.sched_getscheduler(0)
    diagnostics.value("scheduling_policy", _POLICIES.get(number, str(number)))
    diagnostics.value("scheduling_priority", os.sched_getparam(0).sched_priority)
    diagnostics.judge("scheduling", bool(_refusals), "; ".join(_refusals), WARN)


def _threads() -> list[int]:
    """Return the threads of this process; libraries start some when they are loaded."""
    return [int(name) for name in os.listdir("/proc/self/task")]


def _thread_name(thread: int) -> str:
    return Path(f"/proc/self/task/{thread}/comm").read_text(encoding="utf-8")
