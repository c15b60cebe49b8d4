# SPDX-License-Identifier: Apache-2.0
"""Ends what an orchestrator leaves behind when it is killed; a program of its own.

It reads its standard input until the orchestrator closes it, be it by dying. Then it interrupts
every process whose environment carries the mark, so that the recorder can still finish its bag,
and kills what does not end. ``PR_SET_PDEATHSIG`` would reach the children only, not those that a
``ros2 run`` in between has started, and would leave no time to end well.

Only the standard library is used: it starts in a few milliseconds and survives what others break.
"""

import os
import select
import signal
import sys
import time
from collections.abc import Iterator

MARK = "TACTILE_HAND_RUN"
"""Environment variable that every process of a run carries."""

GRACE = 5.0
"""Time that processes have to end after an interrupt [s]."""


def marked(mark: str) -> Iterator[int]:
    """Yield the processes that carry a mark."""
    wanted = f"{MARK}={mark}".encode()
    for entry in os.listdir("/proc"):
        if not entry.isdigit():
            continue
        try:
            with open(f"/proc/{entry}/environ", "rb") as file:
                environment = file.read()
        except OSError:  # gone, or another user's
            continue
        if wanted in environment.split(b"\0"):
            yield int(entry)


def send(number: int, mark: str) -> bool:
    """Send a signal to all marked processes and return whether there were any."""
    found = list(marked(mark))
    for process in found:
        try:
            os.kill(process, number)
        except ProcessLookupError:
            continue
    return bool(found)


def sweep(mark: str, grace: float = GRACE) -> None:
    """Interrupt all marked processes and kill those that are left after a grace period [s]."""
    end = time.monotonic() + grace
    send(signal.SIGINT, mark)
    while any(marked(mark)) and time.monotonic() < end:
        select.select([], [], [], 0.05)
    while send(signal.SIGKILL, mark):
        select.select([], [], [], 0.05)


def main() -> None:
    """Wait for the end of the orchestrator, then sweep."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while os.read(0, 4096):
        pass
    sweep(sys.argv[1])


if __name__ == "__main__":
    main()
