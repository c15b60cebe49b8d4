# SPDX-License-Identifier: Apache-2.0
"""Support for tests over real DDS: isolated domains, processes that leave nothing behind, waits."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from tactile_hand_ros.ros.executables import ExecutableError, child_environment, executable_path
from tactile_hand_ros.ros.executor import make_executor
from tactile_hand_ros.ros.middleware import socket_settings

_PORT_BASE = 32768
_DOMAINS = range(60, 102)
"""Domains for tests; lower ones are left to people, higher ones meet ephemeral ports."""

_POLL_SECONDS = 0.002
_STOP_SECONDS = 5.0
# With a fault handler, SIGABRT makes a process that hangs say where.
_TALKATIVE = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}
_SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@contextlib.contextmanager
def isolated_domain() -> Iterator[int]:
    """Reserve a ROS domain on this machine and set the environment for it.

    Reserving means binding TCP port 32768 + id, the convention of domain_coordinator. Processes
    that are started inside inherit the domain, and discovery stays on this machine.

    Yields:
        The domain id.
    """
    with _reserve() as (_, domain):
        values = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        with _environment({**values, **socket_settings({**os.environ, **values})}):
            yield domain


@contextlib.contextmanager
def _reserve() -> Iterator[tuple[socket.socket, int]]:
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as guard:
            try:
                guard.bind(("localhost", _PORT_BASE + domain))
            except OSError:
                continue
            yield guard, domain
            return
    raise RuntimeError(f"all ROS domains from {_DOMAINS[0]} to {_DOMAINS[-1]} are in use")


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def private_context(domain: int, args: Sequence[str] | None = None) -> Iterator[Context]:
    """Provide an rclpy context of its own, shut down at the end."""
    context = Context()
    rclpy.init(context=context, domain_id=domain, args=None if args is None else list(args))
    try:
        yield context
    finally:
        context.try_shutdown()


@contextlib.contextmanager
def spinning(*nodes: Node) -> Iterator[None]:
    """Serve nodes in a thread that is joined at the end."""
    executor = make_executor(nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    failures: list[BaseException] = []
    thread = threading.Thread(target=_spin, args=(executor, failures))
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        if failures:
            raise failures[0]


def _spin(executor: Any, failures: list[BaseException]) -> None:
    try:
        executor.spin()
    except BaseException as error:
        failures.append(error)


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
    pause = threading.Event()
    while not (result := condition()):
        if time.monotonic() > deadline:
            what = message or getattr(condition, "__name__", "the condition")
            raise TimeoutError(f"waited {timeout:g} s in vain for {what}")
        pause.wait(_POLL_SECONDS)
    return result


class ProcessUnderTest:
    """A process in a group of its own whose output is kept; the group ends with the block."""

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        *,
        env: Mapping[str, str] | None = None,
        cwd: str | os.PathLike[str] | None = None,
    ) -> None:
        """Start the process.

        Args:
            command: Program and arguments.
            env: Variables to set or change.
            cwd: Working directory.
        """
        self.command = [os.fspath(part) for part in command]
        self._files = [tempfile.TemporaryFile("w+b") for _ in range(2)]
        self._process = subprocess.Popen(
            self.command,
            stdin=subprocess.DEVNULL,
            stdout=self._files[0],
            stderr=self._files[1],
            env={**child_environment(), **_TALKATIVE, **(env or {})},
            cwd=cwd,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """The process id, which is the id of its group too."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """The exit code, None while the process runs."""
        return self._process.poll()

    @property
    def stdout(self) -> str:
        """What was written to the standard output so far."""
        return self._read(0)

    @property
    def stderr(self) -> str:
        """What was written to the standard error so far."""
        return self._read(1)

    def _read(self, index: int) -> str:
        descriptor = self._files[index].fileno()
        # The child writes at the same offset: read without moving it.
        return os.pread(descriptor, os.fstat(descriptor).st_size, 0).decode(errors="replace")

    def send(self, number: int) -> None:
        """Send a signal to the process alone, as ``kill`` does."""
        self._process.send_signal(number)

    def interrupt(self) -> None:
        """Send SIGINT to the whole group, as Ctrl-C in a terminal does."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGINT)

    def wait(self, timeout: float = 20.0) -> int:
        """Wait for the end and return the exit code.

        Raises:
            TimeoutError: With all output so far and where each of its threads stood.
        """
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGABRT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_SECONDS)
            raise TimeoutError(f"still running after {timeout:g} s{self._report()}") from None

    def wait_for_output(self, text: str, timeout: float = 20.0) -> None:
        """Wait until a text appears in the output or on stderr.

        Raises:
            TimeoutError: With all output so far.
        """
        try:
            wait_until(lambda: text in self.stdout + self.stderr, timeout, f"'{text}'")
        except TimeoutError as error:
            raise TimeoutError(f"{error}{self._report()}") from None

    def _report(self) -> str:
        return f": {' '.join(self.command)}\n{self.stdout}\n{self.stderr}"

    def stop(self) -> int:
        """End the whole group, politely first, and return the exit code."""
        if self.returncode is None:
            self.interrupt()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_SECONDS)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        return self._process.wait()

    def __enter__(self) -> ProcessUnderTest:
        """Return the process."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the group and drop the output."""
        self.stop()
        for file in self._files:
            file.close()


def find_executable(name: str) -> Path:
    """Return an executable as ``ros2 run`` finds it, or the source tree's when not installed."""
    try:
        return executable_path(name)
    except ExecutableError as error:
        if (_SCRIPTS / name).is_file():
            return _SCRIPTS / name
        raise ExecutableError(f"no executable '{name}' is installed or in {_SCRIPTS}.") from error


def start_executable(
    name: str, *args: str, env: Mapping[str, str] | None = None
) -> ProcessUnderTest:
    """Start an executable of this package.

    Args:
        name: Such as ``plant``.
        *args: Its arguments.
        env: Variables to set or change.
    """
    return ProcessUnderTest([find_executable(name), *args], env=env)
