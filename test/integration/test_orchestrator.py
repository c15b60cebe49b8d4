# SPDX-License-Identifier: Apache-2.0
"""The orchestrator with all its processes: results, refusals, signals, deaths, steering."""

import fcntl
import json
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil
import pytest
import yaml
from rosbags.rosbag2 import Reader
from support.graph import TICK_TOPICS

from bench.processes import CapturedProcess, start_executable
from tactile_hand_ros.bag.reader import summarize
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.cockpit.config import LINK
from tactile_hand_ros.orchestrator.session import START_ORDER
from tactile_hand_ros.ros.processes import PACKAGE, executable_path, wait_until
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.verify.recompute import recompute

# Six processes and their libraries start; a machine that does other things too takes its time.
PATIENCE = 90.0
COMMAND = Path(sys.executable).with_name("tactile-hand")
NEAR = """
extends: paper
description: A target that is nearly reached already.
duration: 0.6
targets:
  - {time: 0.0, position: [0.0, 0.0436, 0.4098]}
  - {time: 0.2, position: [0.0, 0.0438, 0.4098]}
plant: {command_timeout: 60.0}
goal: {position_error: 0.002, rotation_error: 0.02}
"""
TICKS = 301


@pytest.fixture
def near(tmp_path: Path) -> Path:
    """Return a short scenario that reaches its goal."""
    path = tmp_path / "near.yaml"
    path.write_text(NEAR)
    return path


@pytest.fixture
def start(domain: int, tmp_path: Path) -> Iterator[Callable[..., CapturedProcess]]:
    """Return a function that starts orchestrators, which do not outlive the test."""
    with ExitStack() as stack:

        def _start(*arguments: object, env: dict[str, str] | None = None) -> CapturedProcess:
            words = [str(argument) for argument in (*arguments, "--out", tmp_path / "runs")]
            return stack.enter_context(start_executable("orchestrator", *words, env=env))

        yield _start


def end_of(orchestrator: CapturedProcess) -> int:
    """Wait for the end, insist on no traceback and return the exit code."""
    code = orchestrator.wait(PATIENCE)
    assert "Traceback" not in orchestrator.stderr, orchestrator.stderr
    return code


def latest(tmp_path: Path) -> Path:
    return tmp_path / "runs" / "latest"


def summary_of(tmp_path: Path) -> dict[str, object]:
    return dict(json.loads((latest(tmp_path) / "summary.json").read_text()))


def wait_until_running(tmp_path: Path, orchestrator: CapturedProcess) -> None:
    """Wait until some hundred ticks are in the bag."""
    bag = latest(tmp_path) / "bag" / "bag_0.mcap"

    def well_under_way() -> bool:
        assert orchestrator.returncode is None, orchestrator.stdout + orchestrator.stderr
        return bag.exists() and bag.stat().st_size > 200_000

    wait_until(well_under_way, PATIENCE, "a bag that grows")


def member(processes: list[psutil.Process], name: str) -> psutil.Process:
    """Return the process that runs an executable."""
    [found] = [p for p in processes if any(Path(word).name == name for word in p.cmdline())]
    return found


def assert_gone(processes: list[psutil.Process]) -> None:
    wait_until(lambda: not any(p.is_running() for p in processes), 20.0, "the end of all")


def test_what_was_answered_in_an_overloaded_real_time_run_can_be_recomputed(start, near, tmp_path):
    """At 4 kHz no computer answers every tick; those that it answers are right, to the bit."""
    rate = ("--pacing", "realtime", "--set", "plant.rate=4000", "--set", "plant.time_step=0.00025")
    orchestrator = start("--scenario", near, "--no-report", *rate)
    assert end_of(orchestrator) in (0, 1), orchestrator.stdout + orchestrator.stderr
    run = Run(latest(tmp_path))
    answered = np.isfinite(run.record.command).all(axis=1)
    assert 1 < answered.sum() < 0.6 * 4000
    assert all(each.same for each in recompute(run))
    assert "deadlines missed" in orchestrator.stdout
    assert "real time: the nodes share one process; --processes" in orchestrator.stdout
    assert (latest(tmp_path) / "logs" / "composed.log").exists()
    kept = summary_of(tmp_path)["real_time"]
    assert 0.4 < kept["missed_fraction"] <= 1.0
    assert kept["late"] + kept["skipped"] > 0


def test_run_reaches_its_goal_and_is_recorded_completely(domain, tmp_path):
    """Exit code 0, every tick on every topic, and a summary that says what the bag says.

    `tactile-hand run` finds its prefix, and the law beside the scenario, in a folder with a space;
    the commands are those of the in-process loop.
    """
    home = tmp_path / "my runs"
    home.mkdir()
    (home / "my_law.py").write_text(
        "from tactile_hand_ros.control.laws import OptimalLaw\n"
        "class MyLaw(OptimalLaw):\n"
        "    def drive(self, wrench):\n"
        "        return 1.5 * super().drive(wrench)\n"
    )
    (home / "mine.yaml").write_text(f"law: my_law:MyLaw\n{NEAR}")
    unset = {key: text for key, text in os.environ.items() if key != "AMENT_PREFIX_PATH"}
    done = subprocess.run(
        [COMMAND, "run", home / "mine.yaml"],
        cwd=home,
        env=unset,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    folder = home / "runs" / "latest"
    with Reader(folder / "bag") as reader:
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
    run = Run(folder)
    for topic in TICK_TOPICS:
        assert TICKS <= counts[f"/{topic}"] <= TICKS + run.bag_metrics.repeated_ticks, topic
    assert counts["/accepted/desired_pose"] >= 1 and "/desired_pose" not in counts
    assert counts["/robot_description"] == 1

    summary = summary_of(home)
    assert summary["metrics"] == run.metrics.to_dict()
    assert summary["outcome"] == "goal reached"
    assert summary["recording"]["complete"] is True
    assert summary["recording"]["lost_messages"] == 0
    assert np.array_equal(run.record.stamps, 2_000_000 * np.arange(TICKS))
    desired = np.unique(run.record.desired_position[:, 1])
    assert desired.tolist() == [0.0436, 0.0438]
    assert run.record.desired_position[99:101, 1].tolist() == [0.0436, 0.0438]

    scenario = load_scenario(str(home / "mine.yaml"))
    np.testing.assert_array_equal(run.record.command, ClosedLoop(scenario).run().command)
    assert load_scenario(str(folder / "scenario.yaml")) == scenario
    assert run.scenario == scenario
    assert {path.stem for path in (folder / "parameters").iterdir()} == set(START_ORDER)
    logs = {file.stem: file.read_text() for file in (folder / "logs").iterdir()}
    assert set(logs) == set(START_ORDER)
    assert all(text.count("ready") == 1 for text in logs.values()), logs
    assert "paused -> running" in logs["plant"]

    assert "final position error" in done.stdout
    report = folder.resolve() / "report.html"
    assert report.stat().st_size > 500_000
    assert "report: " in done.stdout


def test_live_offers_a_page_until_ctrl_c(domain, tmp_path):
    options = ("--no-browser", "--no-report", "--namespace", "/left", "--out", tmp_path / "runs")
    words = [Path(sys.executable).with_name("tactile-hand"), "live", *map(str, options)]
    with CapturedProcess(words) as live:
        live.wait_for_output(LINK, PATIENCE)
        wait_until_running(tmp_path, live)
        link = re.search(rf"{LINK}(\S+)", live.stdout)[1]
        assert urllib.request.urlopen(link).read().startswith(b"<!doctype html>")
        members = psutil.Process(live.pid).children(recursive=True)
        stored = (latest(tmp_path) / "parameters").glob("*.yaml")
        files = {file.stem: yaml.safe_load(file.read_text()) for file in stored}
        nodes = (files["plant"], files["cockpit"])
        plant, cockpit = (next(iter(each.values()))["ros__parameters"] for each in nodes)
        assert plant["speed"] == 1.0 and plant["palm_motion"]
        assert cockpit["bag"] == str(latest(tmp_path).resolve() / "bag")
        live.send(signal.SIGINT)
        assert end_of(live) == 0, live.stdout
    assert_gone(members)


def test_missed_goal_is_an_exit_code_also_in_a_namespace(start, near, tmp_path):
    """All topics are below the namespace, which ROS arguments give; here of one process."""
    tight = ["--set", "goal.position_error=1e-12", "--duration", "0.3", "--quiet", "--no-report"]
    tight.append("--composed")
    orchestrator = start("--scenario", near, *tight, "--ros-args", "-r", "__ns:=/left", "--")
    assert end_of(orchestrator) == 1
    assert "the final position error is" in orchestrator.stderr
    assert summary_of(tmp_path)["outcome"] == "goal not reached"
    assert not (latest(tmp_path) / "report.html").exists()
    counts = summarize(latest(tmp_path) / "bag").counts
    for topic in TICK_TOPICS:
        assert counts[f"/left/{topic}"] >= 151, topic
    assert "/joint_states" not in counts


def _take_terminal() -> None:
    """Make stdin the terminal of this process, and hear when it closes, also below nohup."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_a_closed_terminal_leaves_a_whole_bag_also_when_the_recorder_was_held_up(domain, tmp_path):
    """SIGHUP, and nobody left to print to: every tick up to the last is there, nothing runs on.

    No node waits for the recorder, but what it missed is kept for it for some seconds.
    """
    ours, theirs = pty.openpty()
    words = ["run", "paper", "--duration", "600", "--out", str(tmp_path / "runs")]
    # A slow computer must not count as silence, nor the plant leave the recorder behind.
    words += ["--set", "plant.command_timeout=60", "--set", "plant.speed=1"]
    orchestrator = subprocess.Popen(
        [COMMAND, *words],
        **dict.fromkeys(("stdin", "stdout", "stderr"), theirs),
        cwd=tmp_path,
        env={**os.environ, "TERM": "xterm"},
        start_new_session=True,
        preexec_fn=_take_terminal,
    )
    os.close(theirs)
    shown = b""
    while b"pose error" not in shown:
        shown += os.read(ours, 4096)
    processes = psutil.Process(orchestrator.pid).children(recursive=True)
    plant, recorder = member(processes, "plant"), member(processes, "recorder")
    busy, bag = plant.cpu_times().user, latest(tmp_path) / "bag" / "bag_0.mcap"
    recorder.suspend()
    wait_until(lambda: plant.cpu_times().user > busy + 0.1, PATIENCE, "some hundred ticks")
    recorder.resume()
    size = bag.stat().st_size
    wait_until(lambda: bag.stat().st_size > size + 400_000, PATIENCE, "a recorder that caught up")
    os.close(ours)
    assert orchestrator.wait(PATIENCE) == 128 + signal.SIGHUP
    assert_gone(processes)
    run, summary = Run(latest(tmp_path)), summary_of(tmp_path)
    assert run.bag_metrics.complete
    assert np.array_equal(run.record.stamps, 2_000_000 * np.arange(len(run.record)))
    assert (summary["outcome"], summary["reasons"]) == ("interrupted", [])
    assert summary["metrics"] == run.metrics.to_dict()


def test_ctrl_c_while_libraries_load_is_no_traceback(start, tmp_path):
    """The signal waits until the import is done; nothing is started."""
    orchestrator = start("--scenario", "paper")
    memory = Path(f"/proc/{orchestrator.pid}/maps")
    wait_until(lambda: "pinocchio" in memory.read_text(), PATIENCE)
    orchestrator.send(signal.SIGINT)
    assert end_of(orchestrator) == 130
    assert orchestrator.stderr == "orchestrator: ended by SIGINT, before anything was started.\n"


def test_death_of_a_node_is_named_and_ends_the_run(start, tmp_path):
    orchestrator = start("--scenario", "paper", "--duration", "600", "--quiet")
    wait_until_running(tmp_path, orchestrator)
    processes = psutil.Process(orchestrator.pid).children(recursive=True)
    assert len(processes) >= len(START_ORDER)
    member(processes, "force_optimizer").kill()
    assert end_of(orchestrator) == 1
    assert "force_optimizer was ended by SIGKILL" in orchestrator.stderr
    assert_gone(processes)
    summary = summary_of(tmp_path)
    assert summary["outcome"] == "failed"
    assert summary["metrics"] == Run(latest(tmp_path)).metrics.to_dict()
    assert summary["metrics"]["ticks"] > 50


def broken_prefix(folder: Path, name: str, program: str) -> dict[str, str]:
    """Return an environment in which one executable of the package is another program."""
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    executables = folder / "lib" / PACKAGE
    index.mkdir(parents=True)
    executables.mkdir(parents=True)
    (index / PACKAGE).touch()
    for other in START_ORDER:
        if other != name:
            (executables / other).symlink_to(executable_path(other))
    (executables / name).write_text(program)
    (executables / name).chmod(0o755)
    return {"AMENT_PREFIX_PATH": f"{folder}{os.pathsep}{os.environ.get('AMENT_PREFIX_PATH', '')}"}


@pytest.mark.parametrize(
    ("program", "patience", "words"),
    [
        ("echo the cable is loose >&2\nexit 3", 80, ("ended with code 3", "the cable is loose")),
        (
            "echo waiting for the bus\nexec tail -f /dev/null",
            2,
            ("not complete after 2 s", "slip_regulator does not", "slip_regulator | waiting for"),
        ),
    ],
)
def test_a_node_that_does_not_start_is_named(start, near, tmp_path, program, patience, words):
    environment = broken_prefix(tmp_path / "prefix", "slip_regulator", f"#!/bin/sh\n{program}\n")
    orchestrator = start("--scenario", near, "--startup-timeout", patience, env=environment)
    wait_until(lambda: latest(tmp_path).exists(), PATIENCE)
    processes = psutil.Process(orchestrator.pid).children(recursive=True)
    assert end_of(orchestrator) == 1
    assert [each for each in words if each not in orchestrator.stderr] == []
    assert_gone(processes)
    assert summary_of(tmp_path)["metrics"] == {}
