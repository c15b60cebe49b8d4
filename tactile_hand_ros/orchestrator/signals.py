# SPDX-License-Identifier: Apache-2.0
"""Signals as a state that is asked, so that no piece of work is torn apart."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
from types import FrameType

_WATCHED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(Exception):
    """The user or the system asked for the end."""


class Signals:
    """Counts SIGINT, SIGTERM and SIGHUP and wakes up the thread that waits.

    Attributes:
        number: The first signal that came, 0 if none.
        count: How many came.
    """

    def __init__(self) -> None:
        """Begin without a signal."""
        self.number = 0
        self.count = 0
        # Its put may interrupt its get in the same thread, as a handler does. An event's set would
        # wait for ever for the lock that the interrupted wait holds.
        self._came: queue.SimpleQueue[int] = queue.SimpleQueue()

    def install(self) -> None:
        """Take over the handlers; a SIGHUP that is ignored stays so, as ``nohup`` means it.

        Shells without job control start what runs in the background with SIGINT ignored. As the
        nodes of rclpy do, it is taken over all the same: it is how a run is ended.
        """
        for number in _WATCHED:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.number = self.number or number
        self.count += 1
        self._came.put(number)

    @property
    def name(self) -> str:
        """Name of the first signal."""
        return signal.Signals(self.number).name if self.number else ""

    @property
    def exit_code(self) -> int:
        """The code that a shell expects after the first signal."""
        return 128 + self.number

    def check(self) -> None:
        """Raise `Interrupted` if a signal came."""
        if self.count:
            raise Interrupted(f"ended by {self.name}")

    def wait(self, seconds: float) -> None:
        """Wait, but not longer than until a signal, and then raise.

        Raises:
            Interrupted: If a signal came.
        """
        self.check()
        with contextlib.suppress(queue.Empty):
            self._came.get(timeout=seconds)
        self.check()


def process_age() -> float:
    """Return how long ago this process began, in s, with the interpreter's own start."""
    with open("/proc/self/stat", encoding="ascii") as file:
        fields = file.read().rpartition(")")[2].split()
    with open("/proc/uptime", encoding="ascii") as file:
        now = float(file.read().split()[0])
    return now - int(fields[19]) / os.sysconf("SC_CLK_TCK")
