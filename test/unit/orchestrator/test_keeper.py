# SPDX-License-Identifier: Apache-2.0
"""The keeper ends what carries its mark: by an interrupt, and what does not end, by a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from tactile_hand_ros.orchestrator import keeper
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until

_PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, {})
print("ready", flush=True)
while True:
    signal.pause()
"""
POLITE = _PROGRAM.format("lambda *_: sys.exit(7)")
STUBBORN = _PROGRAM.format("signal.SIG_IGN")


@pytest.fixture
def running() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def start(stack: ExitStack, program: str, mark: str) -> CapturedProcess:
    command = [sys.executable, "-I", "-S", "-c", program]
    process = CapturedProcess(command, env={keeper.MARK: mark})
    stack.enter_context(process)
    process.wait_for_output("ready")
    return process


def test_what_carries_the_mark_is_interrupted_and_ends_well(running: ExitStack) -> None:
    """Another mark that begins alike is that of another run."""
    ours, other = (start(running, POLITE, mark) for mark in ("mark-7", "mark-78"))
    assert ours.pid in keeper.marked("mark-7") and other.pid not in keeper.marked("mark-7")
    began = time.monotonic()
    keeper.sweep("mark-7")
    assert time.monotonic() - began < 0.9 * keeper.GRACE
    assert ours.wait() == 7 and other.returncode is None
    assert not keeper.send(signal.SIGINT, "mark-7")


def test_what_does_not_end_is_killed_after_the_grace(running: ExitStack) -> None:
    stubborn = start(running, STUBBORN, "mark-8")
    began = time.monotonic()
    keeper.sweep("mark-8", grace=0.2)
    assert time.monotonic() - began >= 0.2
    assert stubborn.wait() == -signal.SIGKILL


def test_it_sweeps_when_its_input_ends_and_no_signal_ends_it_before(running: ExitStack) -> None:
    ours = start(running, POLITE, "mark-9")
    command = [sys.executable, "-I", "-S", keeper.__file__, "mark-9"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as process:
        ignored = 1 << (signal.SIGINT - 1) | 1 << (signal.SIGTERM - 1) | 1 << (signal.SIGHUP - 1)

        def is_deaf() -> bool:
            with open(f"/proc/{process.pid}/status", encoding="ascii") as file:
                (mask,) = [line.split()[1] for line in file if line.startswith("SigIgn")]
            return int(mask, 16) & ignored == ignored

        wait_until(is_deaf)
        os.kill(process.pid, signal.SIGTERM)
        assert process.stdin is not None
        process.stdin.write(b"still there")
        process.stdin.flush()
        assert ours.returncode is None and process.poll() is None
        process.stdin.close()
        assert ours.wait() == 7
        assert process.wait(20) == 0
