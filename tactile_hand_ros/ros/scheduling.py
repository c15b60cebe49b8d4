# SPDX-License-Identifier: Apache-2.0
"""Scheduling of a process: SCHED_FIFO if the command line requests it.

If the system does not permit it, the node runs with normal scheduling and reports this in its
diagnostics.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics

PRIORITY = "--priority"

_POLICIES = {0: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
_HIGHEST = 99
_RESENDING = "dds.asyn"
"""Name prefix of the Fast DDS threads that resend lost messages."""

_refusals: list[str] = []


def raise_priority(priority: int) -> None:
    """Put all existing threads under SCHED_FIFO with a priority, unless it is 0.

    Call it when all nodes have been created. Earlier, the startup work and any child process would
    block other processes.
    """
    _refusals.clear()
    if not priority:
        return
    try:
        for thread in _threads():
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        advice = "run as root, or allow rtprio in limits.conf"
        _refusals.append(f"{PRIORITY} {priority} was refused ({error.strerror}): {advice}")
    yield_while_resending()


def yield_while_resending() -> None:
    """Give the threads that resend lost messages the lowest SCHED_FIFO priority.

    Such a thread polls without sleeping until the publishing thread has removed a message. Threads
    of equal priority do not preempt each other, so two of them block two processors for good.
    """
    for thread in _threads():
        with contextlib.suppress(OSError):  # it has ended
            name = Path(f"/proc/self/task/{thread}/comm").read_text(encoding="utf-8")
            if name.startswith(_RESENDING) and os.sched_getscheduler(thread) == os.SCHED_FIFO:
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(1))


def parse_priority(text: str) -> int:
    """Return a priority from 0 to 99.

    Raises:
        ConfigurationError: If it is anything else.
    """
    if not text.isdecimal() or int(text) > _HIGHEST:
        raise ConfigurationError(
            f"{PRIORITY} is '{text}', expected a whole number from 1 to {_HIGHEST}, or 0 for"
            " normal scheduling."
        )
    return int(text)


def report_scheduling(diagnostics: Diagnostics) -> None:
    """Add policy, priority and denied requests to the diagnostics."""
    number = os.sched_getscheduler(0)
    diagnostics.value("scheduling_policy", _POLICIES.get(number, str(number)))
    diagnostics.value("scheduling_priority", os.sched_getparam(0).sched_priority)
    diagnostics.judge("scheduling", bool(_refusals), "; ".join(_refusals), WARN)


def _threads() -> list[int]:
    """Return the ids of all threads of this process, including those of libraries."""
    return [int(name) for name in os.listdir("/proc/self/task")]
