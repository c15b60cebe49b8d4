# SPDX-License-Identifier: Apache-2.0
"""Start, watch and stop the processes of a run.

Each leads its own session. The kernel signals it when the orchestrator dies, so none is left over.
"""

from __future__ import annotations

import functools
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.processes import (
    PACKAGE,
    ChildProcess,
    end_together,
    executable_directory,
    executable_path,
)

_TAIL = 15  # lines of a log that are shown
_ROS2_PATIENCE = 20.0  # s for ``ros2`` to find this package; one suffices on an idle computer

Program = Callable[[str, list[str]], list[str]]
"""Returns the full command for an executable and the command that it runs under."""


class NodeDiedError(TactileHandError):
    """A process of the run ended unexpectedly."""


class NodeProcess(ChildProcess):
    """One process of the run, with a log file."""

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        """Start a command and create its log."""
        self.name, self.log = name, log
        with log.open("wb") as output:
            super().__init__(command, output, subprocess.STDOUT)

    def tail(self) -> list[str]:
        """Return the last lines of the log."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        return [line for line in text.splitlines() if line.strip()][-_TAIL:]

    def check(self) -> None:
        """Raise NodeDiedError, with code and last line, if the process has ended."""
        code = self.returncode
        if code is None:
            return
        how = (
            f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        )
        lines = self.tail()
        last = f", its last line was: {lines[-1]}" if lines else " without any output"
        raise NodeDiedError(f"{self.name} {how}{last}")


def started_by(name: str, guard: list[str]) -> list[str]:
    """Return the command for an executable under `guard`: ``ros2 run``, or its file without `ros2`.

    Raises:
        TactileHandError: If it does not exist.
    """
    path = executable_path(name)
    if (ros2 := _ros2()) is None:
        return [*guard, str(path)]
    return [*guard, ros2, "run", "--prefix", " ".join(guard), PACKAGE, name]


@functools.cache
def _ros2() -> str | None:
    """Return the ``ros2`` command if it finds this package where the ament index does."""
    if (ros2 := shutil.which("ros2")) is None:
        return None
    try:
        asked = [ros2, "pkg", "prefix", PACKAGE]
        found = subprocess.run(asked, capture_output=True, text=True, timeout=_ROS2_PATIENCE)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return ros2 if Path(found.stdout.strip()) == executable_directory().parents[1] else None


class Processes(AbstractContextManager["Processes"]):
    """The processes of a run; the context stops all of them when it exits."""

    def __init__(self, command: Program = started_by) -> None:
        """Prepare; `command` returns program and first arguments for an executable."""
        self._command = command
        self._started: dict[str, NodeProcess] = {}

    def __exit__(self, *_: object) -> None:
        """Stop all running processes."""
        self.stop([list(self._started)])

    def start(self, name: str, log: Path, *arguments: str, records: bool = False) -> None:
        """Start an executable; `records` lets it finish a bag if the orchestrator dies."""
        # The kernel ends it when its parent dies, also below `ros2 run`.
        guard = ["setpriv", "--pdeathsig", "INT" if records else "KILL", "--"]
        command = [*self._command(name, guard), *arguments]
        self._started[name] = NodeProcess(name, command, log)

    def check(self) -> None:
        """Raise NodeDiedError, with name, code and last line, if one of the processes has ended."""
        for process in self._started.values():
            process.check()

    def tail(self, name: str) -> list[str]:
        """Return the last lines of a process's log."""
        return self._started[name].tail() if name in self._started else []

    def stop(self, order: Sequence[Sequence[str]]) -> list[str]:
        """Stop groups in order, with SIGINT, finally SIGKILL; return a sentence per failure."""
        complaints: list[str] = []
        for names in order:
            group = [self._started[name] for name in names if name in self._started]
            running = [process for process in group if process.returncode is None]
            end_together(group)
            complaints += [
                f"{process.name} did not stop cleanly: code {process.returncode}, see {process.log}"
                for process in running
                # A process that still loads has no handler for SIGINT, one that has closed none
                # for SIGTERM.
                if process.returncode not in (0, -signal.SIGINT, -signal.SIGTERM)
            ]
        return complaints
