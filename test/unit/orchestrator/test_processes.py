# SPDX-License-Identifier: Apache-2.0
"""Processes stop in order, by ever stronger signals, and report how they died."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from bench.processes import CapturedProcess
from tactile_hand_ros.orchestrator import processes as launcher
from tactile_hand_ros.orchestrator.processes import NodeDiedError, NodeProcess, Processes
from tactile_hand_ros.ros import processes as ros_processes
from tactile_hand_ros.ros.processes import executable_directory, wait_until

STUBBORN = "trap '' INT TERM; echo ready; while :; do read line < /dev/zero; done"
POLITE = "trap 'exit 0' INT; echo ready; while :; do tail -f /dev/null & wait; done"


def shells(**programs: str) -> Processes:
    """Return processes whose executables are shell programs."""
    return Processes(command=lambda name, guard: [*guard, "/bin/sh", "-c", programs[name], name])


def started(processes: Processes, folder: Path, *names: str) -> None:
    for name in names:
        log = folder / f"{name}.log"
        processes.start(name, log)
        wait_until(lambda log=log: "ready" in log.read_text())


@pytest.fixture(autouse=True)
def marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Mark the processes of a test, and assert that none is left."""
    monkeypatch.setenv("RUN_OF_TEST", str(tmp_path))
    yield

    def nothing_is_left() -> bool:
        others = [each for each in psutil.process_iter(["environ"]) if each.pid != os.getpid()]
        found = [(each.info["environ"] or {}).get("RUN_OF_TEST") for each in others]
        return str(tmp_path) not in found

    wait_until(nothing_is_left)


def test_groups_end_in_order(tmp_path):
    note = f"trap 'echo $0 >> {tmp_path}/order; exit 0' INT; echo ready; "
    program = note + "while :; do tail -f /dev/null & wait; done"
    with shells(a=program, b=program, c=program) as processes:
        started(processes, tmp_path, "a", "b", "c")
        assert processes.stop([["c"], ["a"], ["b"]]) == []
        assert (tmp_path / "order").read_text().split() == ["c", "a", "b"]


def test_stubborn_process_is_killed_and_named(tmp_path, monkeypatch):
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
    assert tuple(number for number, _ in ros_processes._PATIENCE) == signals
    short = tuple(zip(signals, (0.1, 0.1, 5.0), strict=True))
    monkeypatch.setattr(ros_processes, "_PATIENCE", short)
    with shells(mule=STUBBORN) as processes:
        started(processes, tmp_path, "mule")
        [complaint] = processes.stop([["mule"]])
        assert complaint.startswith(f"mule did not stop cleanly: code -{signal.SIGKILL}")


def test_process_that_has_closed_and_hangs_may_be_terminated(tmp_path, monkeypatch):
    monkeypatch.setattr(ros_processes, "_PATIENCE", ((signal.SIGINT, 0.1), (signal.SIGTERM, 60.0)))
    with shells(mule=STUBBORN.replace(" TERM", "")) as processes:
        started(processes, tmp_path, "mule")
        assert processes.stop([["mule"]]) == []


def test_block_that_fails_leaves_nothing(tmp_path):
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
def test_death_is_described(program, said, tmp_path):
    process = NodeProcess("x", ["/bin/sh", "-c", program], tmp_path / "x.log")
    wait_until(lambda: process.returncode is not None)
    with pytest.raises(NodeDiedError) as caught:
        process.check()
    assert str(caught.value) == said


ORPHANS = """
import signal, sys
from pathlib import Path
from tactile_hand_ros.orchestrator.processes import Processes

folder = Path(sys.argv[1])
recorder = f'''
import signal
from pathlib import Path
try:
    print("ready", flush=True)
    signal.pause()
except KeyboardInterrupt:
    Path("{folder}/bag").write_text("finished")
'''
programs = {
    "suspended": ["/bin/sh", "-c", "kill -STOP $$"],
    "recorder": [sys.executable, "-c", recorder],
}
with Processes(command=lambda name, guard: [*guard, *programs[name]]) as processes:
    for name in programs:
        processes.start(name, folder / f"{name}.log", records=name == "recorder")
    print("started", flush=True)
    signal.pause()
"""


def test_nothing_outlives_a_killed_orchestrator_and_the_recorder_finishes(tmp_path):
    """Not even a suspended node; a recorder receives a signal that lets it finish its bag."""
    with CapturedProcess([sys.executable, "-c", ORPHANS, tmp_path]) as orchestrator:
        orchestrator.wait_for_output("started")
        ready = tmp_path / "recorder.log"
        wait_until(lambda: "ready" in ready.read_text())
        ours = psutil.Process(orchestrator.pid).children(recursive=True)
        assert len(ours) == 2
        orchestrator.send(signal.SIGKILL)
        assert orchestrator.wait() == -signal.SIGKILL
        wait_until(lambda: not any(each.is_running() for each in ours))
    assert (tmp_path / "bag").read_text() == "finished"


@pytest.mark.parametrize(
    ("prefix", "used"), [(executable_directory().parents[1], True), ("/opt/other", False)]
)
def test_ros2_run_is_used_where_it_finds_the_same_package(prefix, used, tmp_path, monkeypatch):
    """A script replaces `ros2`, which has no wheel, and does the same as `ros2 run`."""
    ros2 = tmp_path / "ros2"
    ros2.write_text(
        f'#!/bin/sh\nif [ "$1" = pkg ]; then echo {prefix}; exit; fi\n'
        f'echo "$@" > {tmp_path}/asked; exec $3 {executable_directory()}/"$5" "$6"\n'
    )
    ros2.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    launcher._ros2.cache_clear()
    try:
        with Processes() as run:
            run.start("plant", tmp_path / "log", "--help")
            wait_until(lambda: "options:" in (tmp_path / "log").read_text(), 60.0, "the help")
    finally:
        launcher._ros2.cache_clear()
    asked = tmp_path / "asked"
    expected = "run --prefix setpriv --pdeathsig KILL -- tactile_hand_ros plant --help"
    assert (asked.read_text().strip() if asked.exists() else "") == (expected if used else "")
