# SPDX-License-Identifier: Apache-2.0
"""The processes of a run: started as ``ros2 run`` does, each in its own session, and ended."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

import rclpy

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.orchestrator import keeper
from tactile_hand_ros.ros.processes import PACKAGE, ChildProcess, end_together, executable_path

_TAIL = 15  # lines of a log that are shown


class NodeDiedError(TactileHandError):
    """A process of the run ended by itself."""


def start_command(name: str) -> list[str]:
    """Return program and first arguments for an executable of this package.

    ``ros2 run`` where that command belongs to the ROS installation in use; else the file that it
    would start.

    Raises:
        ExecutableError: If it does not exist.
    """
    path = executable_path(name)
    ros2 = shutil.which("ros2")
    if ros2 is not None and Path(ros2).resolve().parents[1] in Path(rclpy.__file__).parents:
        return [ros2, "run", PACKAGE, name]
    return [str(path)]


class NodeProcess(ChildProcess):
    """One process of the run, with a log.

    Attributes:
        name: Name of the executable.
        log: File with its output.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path, mark: str) -> None:
        """Start it.

        Args:
            name: Name of the executable.
            command: Program and arguments.
            log: File to create.
            mark: Mark by which the keeper finds it.
        """
        self.name = name
        self.log = log
        with log.open("wb") as output:
            super().__init__(command, output, subprocess.STDOUT, env={keeper.MARK: mark})

    def tail(self) -> list[str]:
        """Return the last lines of the log."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        return [line for line in text.splitlines() if line.strip()][-_TAIL:]

    def check(self) -> None:
        """Raise if the process has ended.

        Raises:
            NodeDiedError: With its code and its last line.
        """
        code = self.returncode
        if code is None:
            return
        how = (
            f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        )
        lines = self.tail()
        last = f", its last line was: {lines[-1]}" if lines else " without any output"
        raise NodeDiedError(f"{self.name} {how}{last}")


class Processes:
    """The processes of a run and their keeper; nothing is left when the block ends."""

    def __init__(
        self,
        in_a_hurry: Callable[[], bool] = lambda: False,
        lock: socket.socket | None = None,
        command: Callable[[str], list[str]] = start_command,
    ) -> None:
        """Prepare.

        Args:
            in_a_hurry: Asked while waiting for an end: whether to be less patient.
            lock: The lock of the run. The keeper shares it, since it may outlive the orchestrator.
            command: Returns program and first arguments for the name of an executable.
        """
        self._command = command
        self._in_a_hurry = in_a_hurry
        self._shared = () if lock is None else (lock.fileno(),)
        self._mark = uuid.uuid4().hex
        self._started: dict[str, NodeProcess] = {}
        self._keeper: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Processes:
        """Start the keeper before anything that it might have to end."""
        self._keeper = subprocess.Popen(
            [sys.executable, "-I", "-S", keeper.__file__, self._mark],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=self._shared,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        """End what still runs, then the keeper."""
        self.stop([list(self._started)])
        if self._keeper is not None and self._keeper.stdin is not None:
            self._keeper.stdin.close()
            self._keeper.wait()

    def start(self, name: str, log: Path, *arguments: str) -> None:
        """Start an executable of this package.

        Args:
            name: Its name.
            log: File for its output.
            *arguments: Its arguments.

        Raises:
            ExecutableError: If it does not exist.
        """
        command = [*self._command(name), *arguments]
        self._started[name] = NodeProcess(name, command, log, self._mark)

    def check(self) -> None:
        """Raise if one of the processes has ended.

        Raises:
            NodeDiedError: With its name, code and last line.
        """
        for process in self._started.values():
            process.check()

    def tail(self, name: str) -> list[str]:
        """Return the last lines of a process's log."""
        return self._started[name].tail() if name in self._started else []

    def stop(self, order: Sequence[Sequence[str]]) -> list[str]:
        """End processes, SIGINT first, SIGKILL last.

        Args:
            order: Names of those that end together, one group after the other.

        Returns:
            A sentence for each that did not end well.
        """
        complaints: list[str] = []
        for names in order:
            group = [self._started[name] for name in names if name in self._started]
            complaints += self._stop_together(group)
        return complaints

    def _stop_together(self, group: list[NodeProcess]) -> list[str]:
        running = [process for process in group if process.returncode is None]
        end_together(group, self._in_a_hurry)
        return [
            f"{process.name} did not end well: code {process.returncode}, see {process.log}"
            for process in running
            # While it still loads, a process has no handler for SIGINT yet.
            if process.returncode not in (0, -signal.SIGINT)
        ]
