# SPDX-License-Identifier: Apache-2.0
"""Find this package's executables, and run processes that end together with their children."""

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

from ament_index_python.packages import get_package_prefix

from tactile_hand_ros.errors import TactileHandError

PACKAGE = "tactile_hand_ros"


def executable_directory() -> Path:
    """Return ``<prefix>/lib/tactile_hand_ros``, the only folder that ``ros2 run`` searches.

    Raises:
        TactileHandError: If the package is not in the ament index.
    """
    try:
        prefix = get_package_prefix(PACKAGE)
    except (LookupError, OSError) as error:  # OSError: there is no index
        searched = os.environ.get("AMENT_PREFIX_PATH", "")
        raise TactileHandError(
            f"The ament index at AMENT_PREFIX_PATH='{searched}' has no {PACKAGE}:"
            " build it (make setup, or colcon build) and source its setup file."
        ) from error
    return Path(prefix) / "lib" / PACKAGE


def executable_path(name: str) -> Path:
    """Return the file that ``ros2 run tactile_hand_ros <name>`` starts.

    Raises:
        TactileHandError: If there is no such executable.
    """
    path = executable_directory() / name
    if not (path.is_file() and os.access(path, os.X_OK)):
        raise TactileHandError(f"There is no executable {path}; build and install the package.")
    return path


def child_environment() -> dict[str, str]:
    """Return the environment for a child process, with this interpreter first on PATH.

    The executables start with ``#!/usr/bin/env python3``. Without an activated virtual environment
    they would find another Python.
    """
    inherited = os.environ.get("PATH", os.defpath)
    return {**os.environ, "PATH": os.pathsep.join([str(Path(sys.prefix, "bin")), inherited])}


_POLL_SECONDS = 0.002
# Signals from soft to hard, with the time [s] until the next.
_PATIENCE = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0))
_HAS_ENDED = os.WEXITED | os.WNOHANG | os.WNOWAIT


def wait_until(condition: Callable[[], Any], timeout: float = 60.0, message: str = "") -> Any:
    """Wait up to `timeout` [s] until a condition is true and return its value.

    Raises:
        TimeoutError: With the message, if it is still false.
    """
    deadline = time.monotonic() + timeout
    pause = threading.Event()  # signals do not interrupt its wait
    while not (result := condition()):
        if time.monotonic() > deadline:
            what = message or getattr(condition, "__name__", "the condition")
            raise TimeoutError(f"timed out after {timeout:g} s waiting for {what}")
        pause.wait(_POLL_SECONDS)
    return result


class ChildProcess:
    """A child process in its own session, which Ctrl-C in the terminal does not reach."""

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        stdout: Any,
        stderr: Any,
        *,
        env: Mapping[str, str] | None = None,
    ) -> None:
        """Start the process; `env` holds the variables to set or change."""
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
        """The process id, which is also the id of its group."""
        return int(self._process.pid)

    @property
    def returncode(self) -> int | None:
        """The exit code, or None while the process runs; after its exit, its group is killed."""
        if self._process.returncode is None and os.waitid(os.P_PID, self.pid, _HAS_ENDED):
            # Before the process is reaped; afterwards its id could belong to another group.
            os.killpg(self.pid, signal.SIGKILL)
        return self._process.poll()

    def send_to_group(self, number: int) -> None:
        """Send a signal to the process and its children, as a terminal does."""
        if self.returncode is None:
            os.killpg(self.pid, number)


def end_together(processes: Sequence[ChildProcess]) -> None:
    """End processes and their children together: SIGINT first, SIGKILL last."""

    def have_ended() -> bool:
        return all(process.returncode is not None for process in processes)

    for number, patience in _PATIENCE:
        for process in processes:
            process.send_to_group(number)
            process.send_to_group(signal.SIGCONT)  # a stopped one could not end
        with suppress(TimeoutError):
            wait_until(have_ended, patience)
