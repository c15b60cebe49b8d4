# SPDX-License-Identifier: Apache-2.0
"""Find this package's executables, and run processes that end with all that they have started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from tactile_hand_ros.errors import TactileHandError

PACKAGE = "tactile_hand_ros"


class ExecutableError(TactileHandError):
    """An executable of this package that cannot be found."""


def executable_directory() -> Path:
    """Return ``<prefix>/lib/tactile_hand_ros``, the only place where ``ros2 run`` looks.

    Raises:
        ExecutableError: The package is not in the ament index.
    """
    try:
        prefix = get_package_prefix(PACKAGE)
    except (PackageNotFoundError, LookupError, OSError) as error:  # OSError: there is no index
        searched = os.environ.get("AMENT_PREFIX_PATH", "")
        raise ExecutableError(
            f"The ament index at AMENT_PREFIX_PATH='{searched}' has no {PACKAGE}:"
            " build it (make setup, or colcon build) and source or set the prefix."
        ) from error
    return Path(prefix) / "lib" / PACKAGE


def executable_names() -> list[str]:
    """Return the names that ``ros2 run tactile_hand_ros`` offers, sorted."""
    return sorted(path.name for path in executable_directory().iterdir() if _runs(path))


def executable_path(name: str) -> Path:
    """Return the file that ``ros2 run tactile_hand_ros <name>`` would start.

    Args:
        name: Name of the executable, such as ``plant``.

    Raises:
        ExecutableError: No such executable.
    """
    path = executable_directory() / name
    if not name or Path(name).name != name or not _runs(path):
        known = ", ".join(executable_names())
        raise ExecutableError(f"There is no executable '{name}': choose one of {known}.")
    return path


def child_environment() -> dict[str, str]:
    """Return the environment for a child process, with this interpreter first on PATH.

    The executables start with ``#!/usr/bin/env python3``: without an activated virtual environment
    they would find another Python.
    """
    environment = dict(os.environ)
    inherited = environment.get("PATH", os.defpath)
    environment["PATH"] = os.pathsep.join([str(Path(sys.prefix, "bin")), inherited])
    return environment


def _runs(path: Path) -> bool:
    """Return whether a path is a file with its run bit set."""
    return path.is_file() and os.access(path, os.X_OK)


_POLL_SECONDS = 0.002
_STOP_SECONDS = 5.0
# How long a signal may take until the next, harder one.
_PATIENCE = ((signal.SIGINT, _STOP_SECONDS), (signal.SIGTERM, 2.0), (signal.SIGKILL, _STOP_SECONDS))
_HAS_ENDED = os.WEXITED | os.WNOHANG | os.WNOWAIT


def wait_until(condition: Callable[[], Any], timeout: float = 10.0, message: str = "") -> Any:
    """Wait until a condition is true and return its value.

    Args:
        condition: Asked again and again.
        timeout: Longest wait [s].
        message: What was waited for, for the error.

    Raises:
        TimeoutError: If the condition stays false.
    """
    deadline = time.monotonic() + timeout
    pause = threading.Event()  # which signals do not cut short
    while not (result := condition()):
        if time.monotonic() > deadline:
            what = message or getattr(condition, "__name__", "the condition")
            raise TimeoutError(f"waited {timeout:g} s in vain for {what}")
        pause.wait(_POLL_SECONDS)
    return result


class ChildProcess:
    """A process that leads a session of its own: a Ctrl-C in the terminal does not reach it."""

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        stdout: Any,
        stderr: Any,
        *,
        env: Mapping[str, str] | None = None,
    ) -> None:
        """Start it.

        Args:
            command: Program and arguments.
            stdout: File for the standard output.
            stderr: File for the standard error, or ``subprocess.STDOUT``.
            env: Variables to set or change.
        """
        self.command = [os.fspath(part) for part in command]
        self._process = subprocess.Popen(
            self.command,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            env={**child_environment(), "PYTHONUNBUFFERED": "1", **(env or {})},
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """The process id, which is the id of its group too."""
        return int(self._process.pid)

    @property
    def returncode(self) -> int | None:
        """The exit code, None while the process runs; with it, all that it has started ends."""
        if self._process.returncode is None and os.waitid(os.P_PID, self.pid, _HAS_ENDED):
            # Before it is reaped: then its number could be that of another group.
            os.killpg(self.pid, signal.SIGKILL)
        return self._process.poll()

    def send(self, number: int) -> None:
        """Send a signal to the process alone, as ``kill`` does."""
        self._process.send_signal(number)

    def send_to_group(self, number: int) -> None:
        """Send a signal to the process and all that it has started, as a terminal does."""
        if self.returncode is None:
            os.killpg(self.pid, number)


def end_together(processes: Sequence[ChildProcess]) -> None:
    """End processes, and all that they have started, together: SIGINT first, SIGKILL last."""

    def have_ended() -> bool:
        return all(process.returncode is not None for process in processes)

    for number, patience in _PATIENCE:
        for process in processes:
            process.send_to_group(number)
        with suppress(TimeoutError):
            wait_until(have_ended, patience)
