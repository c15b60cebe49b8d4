# SPDX-License-Identifier: Apache-2.0
"""Isolated processes and ROS domains for benchmarks and tests."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import signal
import socket
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from unittest import mock

from tactile_hand_ros.ros.middleware import socket_settings
from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.ros.processes import (
    ChildProcess,
    end_together,
    executable_path,
    wait_until,
)
from tactile_hand_ros.scenario.scenario import NODES, Scenario

_PORT_BASE = 32768
_ABORT_SECONDS = 5.0
_DOMAINS = range(60, 102)
"""Lower domains are left to users; higher ones collide with ephemeral ports."""
_TURNS = itertools.cycle(random.sample(_DOMAINS, len(_DOMAINS)))
"""In turns, because a killed node is still discovered in its domain for 20 s."""


@contextlib.contextmanager
def isolated_domain() -> Iterator[int]:
    """Reserve a ROS domain on this machine and set the environment for it.

    Reserving means binding TCP port 32768 + id, the convention of domain_coordinator. Processes
    started inside inherit the domain, and discovery is limited to this machine.
    """
    with _reserve() as domain:
        values = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        values |= socket_settings({**os.environ, **values})
        with mock.patch.dict(os.environ, values):
            yield domain


@contextlib.contextmanager
def _reserve() -> Iterator[int]:
    for domain in itertools.islice(_TURNS, len(_DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as guard:
            try:
                guard.bind(("localhost", _PORT_BASE + domain))
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError(f"all ROS domains from {_DOMAINS[0]} to {_DOMAINS[-1]} are in use")


class CapturedProcess(ChildProcess):
    """A process with captured output; its group ends with the block."""

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        *,
        env: Mapping[str, str] | None = None,
    ) -> None:
        """Start the process; see `ChildProcess`."""
        self._files = [tempfile.TemporaryFile("w+b") for _ in range(2)]  # noqa: SIM115 (they live as long as it)
        # With the fault handler, SIGABRT prints the stack of a hung process.
        env = {"PYTHONFAULTHANDLER": "1", **(env or {})}
        super().__init__(command, *self._files, env=env)

    @property
    def stdout(self) -> str:
        """Text on standard output so far."""
        return self._read(0)

    @property
    def stderr(self) -> str:
        """Text on standard error so far."""
        return self._read(1)

    def _read(self, index: int) -> str:
        descriptor = self._files[index].fileno()
        # The child shares the file offset, so read without moving it.
        return os.pread(descriptor, os.fstat(descriptor).st_size, 0).decode(errors="replace")

    def send(self, number: int) -> None:
        """Send a signal to the process alone, as ``kill`` does."""
        if self.returncode is None:  # Popen would reap an ended one, and its group would live on
            os.kill(self.pid, number)

    def wait(self, timeout: float = 20.0) -> int:
        """Wait for the end and return the exit code.

        Raises:
            TimeoutError: With all output so far and the stacks of its threads.
        """
        try:
            wait_until(lambda: self.returncode is not None, timeout)
        except TimeoutError:
            raise self._stuck(f"still running after {timeout:g} s") from None
        assert self.returncode is not None
        return self.returncode

    def wait_for_output(self, text: str, timeout: float = 20.0) -> None:
        """Wait until a text appears in the output or on stderr.

        Raises:
            TimeoutError: With all output so far and the stacks of its threads.
        """
        try:
            wait_until(lambda: text in self.stdout + self.stderr, timeout, f"'{text}'")
        except TimeoutError as error:
            raise self._stuck(str(error)) from None

    def _stuck(self, problem: str) -> TimeoutError:
        self.send(signal.SIGABRT)
        with suppress(TimeoutError):
            wait_until(lambda: self.returncode is not None, _ABORT_SECONDS)
        return TimeoutError(f"{problem}: {' '.join(self.command)}\n{self.stdout}\n{self.stderr}")

    def __enter__(self) -> CapturedProcess:
        """Return the process."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the group and drop the output."""
        end_together([self])
        self._process.wait()
        for file in self._files:
            file.close()


def start_executable(
    name: str, *args: str, env: Mapping[str, str] | None = None
) -> CapturedProcess:
    """Start an executable of this package such as ``plant``, as ``ros2 run`` does."""
    return CapturedProcess([executable_path(name), *args], env=env)


def parameter_files(scenario: Scenario, folder: Path, nodes: Iterable[str] = NODES) -> list[str]:
    """Write the parameters of nodes; return the arguments that name the files."""
    arguments = []
    for name in nodes:
        file = folder / f"{name}.yaml"
        file.write_text(to_params_yaml(getattr(scenario, name), name))
        arguments += ["--params-file", str(file)]
    return arguments
