# SPDX-License-Identifier: Apache-2.0
"""Processes end in order, by ever harder signals, and say how they died."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tactile_hand_ros.orchestrator import processes as module
from tactile_hand_ros.orchestrator.keeper import MARK
from tactile_hand_ros.orchestrator.processes import NodeDiedError, NodeProcess, Processes
from tactile_hand_ros.orchestrator.signals import Interrupted, Signals, process_age
from tactile_hand_ros.ros.processes import wait_until

STUBBORN = "trap '' INT TERM; echo ready; while :; do read line < /dev/zero; done"
POLITE = "trap 'exit 0' INT; echo ready; while :; do tail -f /dev/null & wait; done"
# Leaves a child behind that ignores the signals.
PARENT = "(trap '' INT TERM; exec tail -f /dev/null) & echo ready; trap 'exit 0' INT; wait"


class Shells:
    """Stands in for the launcher: executables are shell programs."""

    def __init__(self, **programs: str) -> None:
        """Take the programs by name."""
        self._programs = programs

    def command(self, name: str) -> list[str]:
        """Return the shell with a program; further arguments are ignored."""
        return ["/bin/sh", "-c", self._programs[name], name]


def started(processes: Processes, folder: Path, *names: str) -> None:
    """Start programs and wait until they are ready."""
    for name in names:
        log = folder / f"{name}.log"
        processes.start(name, log)
        wait_until(lambda log=log: "ready" in log.read_text())


def _is_ours(process: psutil.Process, folder: Path) -> bool:
    try:
        return process.environ().get("RUN_OF_TEST") == str(folder)
    except psutil.Error:
        return False


@pytest.fixture(autouse=True)
def marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let the processes of a test be told from all others, and insist that none is left."""
    monkeypatch.setenv("RUN_OF_TEST", str(tmp_path))
    yield
    left = [p for p in psutil.process_iter() if _is_ours(p, tmp_path) and p.pid != os.getpid()]
    assert not left


def test_groups_end_in_order(tmp_path: Path) -> None:
    note = f"trap 'echo $0 >> {tmp_path}/order; exit 0' INT; echo ready; "
    program = note + "while :; do tail -f /dev/null & wait; done"
    with Processes(Shells(a=program, b=program, c=program)) as processes:
        started(processes, tmp_path, "a", "b", "c")
        assert processes.stop([["c"], ["a"], ["b"]]) == []
        assert (tmp_path / "order").read_text().split() == ["c", "a", "b"]


def test_stubborn_process_is_killed_sooner_in_a_hurry_and_is_named(tmp_path: Path) -> None:
    with Processes(Shells(mule=STUBBORN), lambda: True) as processes:
        started(processes, tmp_path, "mule")
        [complaint] = processes.stop([["mule"]])
        assert complaint.startswith(f"mule did not end well: code -{signal.SIGKILL}")


def test_children_of_a_process_end_with_it(tmp_path: Path) -> None:
    with Processes(Shells(parent=PARENT)) as processes:
        started(processes, tmp_path, "parent")
        processes.stop([["parent"]])


def test_block_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyError), Processes(Shells(a=POLITE)) as processes:
        started(processes, tmp_path, "a")
        processes.start("b", tmp_path / "b.log")


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("echo one; echo two >&2; exit 7", "x ended with code 7, its last line was: two"),
        ("exit 7", "x ended with code 7 without a word"),
        ("kill -KILL $$", "x was ended by SIGKILL without a word"),
    ],
)
def test_death_is_described(program: str, said: str, tmp_path: Path) -> None:
    process = NodeProcess("x", ["/bin/sh", "-c", program], tmp_path / "x.log", "mark")
    wait_until(lambda: process.returncode is not None)
    with pytest.raises(NodeDiedError) as caught:
        process.check()
    assert str(caught.value) == said


def test_process_carries_its_mark_and_a_session_of_its_own(tmp_path: Path) -> None:
    program = f"echo ${MARK}"
    process = NodeProcess("x", ["/bin/sh", "-c", program], tmp_path / "x.log", "the mark")
    wait_until(lambda: process.returncode is not None)
    assert process.tail() == ["the mark"]


def test_signals_are_counted_and_the_first_decides() -> None:
    signals = Signals()
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        signals.install()
        signals.check()
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        wait_until(lambda: signals.count == 2)
        with pytest.raises(Interrupted, match="SIGTERM"):
            signals.wait(60.0)
        assert signals.exit_code == 143
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_age_counts_from_the_start_of_the_process() -> None:
    """Against psutil, whose idea of the boot time is rounded to a second."""
    created = psutil.Process().create_time()
    before = time.time() - created
    age = process_age()
    assert before - 1.0 <= age <= time.time() - created + 1.0


def test_the_keeper_leads_a_session_of_its_own_and_shares_the_claim(tmp_path: Path) -> None:
    """A Ctrl-C does not reach it, and the claim lasts as long as it does."""
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as held,
        Processes(Shells(), held=held) as processes,  # type: ignore[arg-type]
    ):
        keeper = processes._keeper
        assert keeper is not None and os.getsid(keeper.pid) == keeper.pid
        inode = os.fstat(held.fileno()).st_ino
        shared = os.stat(f"/proc/{keeper.pid}/fd/{held.fileno()}").st_ino
        assert shared == inode and keeper.poll() is None
    assert keeper.returncode == 0


def test_a_ros2_that_does_not_answer_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_PROBE_SECONDS", 0.05)
    probe = subprocess.Popen(["/bin/sh", "-c", "exec sleep 60"], stdout=subprocess.PIPE, text=True)
    assert not module.Launcher._finds_the_package(probe)
    assert probe.returncode == -signal.SIGKILL
