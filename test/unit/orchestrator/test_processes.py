# SPDX-License-Identifier: Apache-2.0
"""Processes end in order, by ever harder signals, and say how they died."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import rclpy

from tactile_hand_ros.orchestrator.keeper import MARK
from tactile_hand_ros.orchestrator.processes import (
    NodeDiedError,
    NodeProcess,
    Processes,
    start_command,
)
from tactile_hand_ros.ros.processes import PACKAGE, executable_path, wait_until

STUBBORN = "trap '' INT TERM; echo ready; while :; do read line < /dev/zero; done"
POLITE = "trap 'exit 0' INT; echo ready; while :; do tail -f /dev/null & wait; done"
# Leaves a child behind that ignores the signals.
PARENT = "(trap '' INT TERM; exec tail -f /dev/null) & echo ready; trap 'exit 0' INT; wait"


def shells(**programs: str) -> Processes:
    """Return processes whose executables are shell programs."""
    return Processes(command=lambda name: ["/bin/sh", "-c", programs[name], name])


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
    with shells(a=program, b=program, c=program) as processes:
        started(processes, tmp_path, "a", "b", "c")
        assert processes.stop([["c"], ["a"], ["b"]]) == []
        assert (tmp_path / "order").read_text().split() == ["c", "a", "b"]


def test_stubborn_process_is_killed_sooner_in_a_hurry_and_is_named(tmp_path: Path) -> None:
    with Processes(lambda: True, command=lambda name: ["/bin/sh", "-c", STUBBORN]) as processes:
        started(processes, tmp_path, "mule")
        [complaint] = processes.stop([["mule"]])
        assert complaint.startswith(f"mule did not end well: code -{signal.SIGKILL}")


def test_children_of_a_process_end_with_it(tmp_path: Path) -> None:
    with shells(parent=PARENT) as processes:
        started(processes, tmp_path, "parent")
        processes.stop([["parent"]])


def test_block_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyError), shells(a=POLITE) as processes:
        started(processes, tmp_path, "a")
        processes.start("b", tmp_path / "b.log")


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("echo one; echo two >&2; exit 7", "x ended with code 7, its last line was: two"),
        ("exit 7", "x ended with code 7 without any output"),
        ("kill -KILL $$", "x was ended by SIGKILL without any output"),
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


def test_the_keeper_shares_the_lock_of_the_run(tmp_path: Path) -> None:
    """The lock lasts as long as anything of the run, also when the orchestrator is killed."""
    name = f"\0tactile_hand_ros/test/{os.getpid()}"
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    lock.bind(name)
    other = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    with Processes(lock=lock):
        lock.close()
        with pytest.raises(OSError, match="in use"):
            other.bind(name)
    other.bind(name)
    other.close()


@pytest.mark.parametrize("belongs", [True, False])
def test_ros2_run_is_used_where_it_belongs_to_the_rclpy_in_use(
    belongs: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix, elsewhere = tmp_path / "ros", tmp_path / "elsewhere"
    for folder in (prefix, elsewhere):
        (folder / "bin").mkdir(parents=True)
        (folder / "bin" / "ros2").write_text("#!/bin/sh\n")
        (folder / "bin" / "ros2").chmod(0o755)
    ros2 = (prefix if belongs else elsewhere) / "bin" / "ros2"
    monkeypatch.setenv("PATH", str(ros2.parent), prepend=":")
    monkeypatch.setattr(rclpy, "__file__", str(prefix / "lib" / "python" / "rclpy" / "x.py"))
    expected = [str(ros2), "run", PACKAGE, "plant"] if belongs else [str(executable_path("plant"))]
    assert start_command("plant") == expected
