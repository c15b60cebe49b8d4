# SPDX-License-Identifier: Apache-2.0
"""How a process runs: SCHED_FIFO and the processors it may use.

Both are asked for on the command line. Policy and processors are set before ROS starts: the threads
of the middleware inherit them. What the system does not permit does not stop the node: it runs as
before and reports it in its diagnostics.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.diagnostics import WARN, Diagnostics

PRIORITY, CPUS = "--priority", "--cpus"
USAGE = f"{PRIORITY} N (SCHED_FIFO, 1 to 99), {CPUS} LIST (as 0,2-3)"

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
        cpus: Processors to run on; empty leaves them as they are.
    """

    priority: int = 0
    cpus: tuple[int, ...] = ()

    @property
    def arguments(self) -> list[str]:
        """The words that ask an executable for it."""
        priority = [PRIORITY, str(self.priority)] if self.priority else []
        cpus = [CPUS, format_cpus(self.cpus)] if self.cpus else []
        return priority + cpus

    def restrict(self) -> None:
        """Set the processors for all threads and for those that they will start."""
        _refusals.clear()
        if self.cpus:
            what = f"{CPUS} {format_cpus(self.cpus)}"
            here = format_cpus(sorted(os.sched_getaffinity(0)))
            _ask(what, self._set_cpus, f"this process runs on {here}")

    def raise_priority(self) -> None:
        """Set the priority of all threads that there are, when all nodes have been made.

        Not earlier: what a start takes, and a process that it starts, must not keep others waiting.
        """
        if self.priority:
            what = f"{PRIORITY} {self.priority}"
            _ask(what, self._set_policy, "run as root, or allow rtprio in limits.conf")
            yield_while_resending()

    def _set_policy(self) -> None:
        for thread in _threads():
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(self.priority))

    def _set_cpus(self) -> None:
        for thread in _threads():
            os.sched_setaffinity(thread, self.cpus)


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


def use_batch_scheduling() -> None:
    """Ask for SCHED_BATCH: the same fraction of the time, but no interruption of other processes.

    For one that no other waits for. Where the kernel has no such policy nothing changes.
    """
    with contextlib.suppress(AttributeError, OSError):
        for thread in _threads():
            if os.sched_getscheduler(thread) == os.SCHED_OTHER:
                os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))


def take_scheduling(words: Sequence[str]) -> tuple[Scheduling, list[str]]:
    """Read the options out of a command line.

    Args:
        words: Arguments without those of ROS.

    Returns:
        What is asked for, and the words that are left.

    Raises:
        ConfigurationError: If a value is missing or none of those allowed.
    """
    left, values = [], {PRIORITY: "0", CPUS: ""}
    rest = iter(words)
    for word in rest:
        name, equals, value = word.partition("=")
        if name in values:
            values[name] = value if equals else next(rest, "")
        else:
            left.append(word)
    asked = any(word.partition("=")[0] == CPUS for word in words)
    cpus = chosen_cpus(values[CPUS]) if asked else ()
    return Scheduling(parse_priority(values[PRIORITY]), cpus), left


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


def parse_cpus(text: str) -> tuple[int, ...]:
    """Read a list of processors such as ``0,2-3``.

    Raises:
        ConfigurationError: If it is not such a list.
    """
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        last = last if dash else first
        if not (first.isdecimal() and last.isdecimal()) or int(last) < int(first):
            raise ConfigurationError(
                f"{CPUS} is '{text}', expected numbers of processors such as 0,2-3."
            )
        found.update(range(int(first), int(last) + 1))
    return tuple(sorted(found))


def chosen_cpus(text: str) -> tuple[int, ...]:
    """Read a list of processors to run on, such as ``0,2-3``.

    Raises:
        ConfigurationError: If it is not such a list, or names a processor that is not there.
    """
    cpus, here = parse_cpus(text), present_cpus()
    missing = [cpu for cpu in cpus if cpu not in here]
    if missing:
        raise ConfigurationError(
            f"{CPUS} is '{text}', but this machine has no processor {missing[0]}; it has"
            f" {format_cpus(here)}."
        )
    return cpus


def present_cpus() -> tuple[int, ...]:
    """Return the processors that are switched on; a container may allow fewer."""
    file = Path("/sys/devices/system/cpu/online")
    if file.exists():
        return parse_cpus(file.read_text(encoding="ascii").strip())
    return tuple(range(os.cpu_count() or 1))


def format_cpus(cpus: Sequence[int]) -> str:
    """Write processors as `parse_cpus` reads them."""
    return ",".join(map(str, cpus))


def report_scheduling(diagnostics: Diagnostics) -> None:
    """Put policy, priority and processors in force into diagnostics, and what was refused."""
    number = os.sched_getscheduler(0)
    diagnostics.value("scheduling_policy", _POLICIES.get(number, str(number)))
    diagnostics.value("scheduling_priority", os.sched_getparam(0).sched_priority)
    diagnostics.value("scheduling_cpus", format_cpus(sorted(os.sched_getaffinity(0))))
    diagnostics.judge("scheduling", bool(_refusals), "; ".join(_refusals), WARN)


def _threads() -> list[int]:
    """Return the threads of this process; libraries start some when they are loaded."""
    return [int(name) for name in os.listdir("/proc/self/task")]


def _thread_name(thread: int) -> str:
    return Path(f"/proc/self/task/{thread}/comm").read_text(encoding="utf-8")


def _ask(what: str, request: Callable[[], None], advice: str) -> None:
    try:
        request()
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        _refusals.append(f"{what} was refused ({reason}): {advice}")
