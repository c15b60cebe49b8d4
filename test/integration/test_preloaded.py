# SPDX-License-Identifier: Apache-2.0
"""A process that has loaded modules becomes executables, which look and end like any other."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tactile_hand_ros.ros.preloaded import Forked, Preloaded
from tactile_hand_ros.ros.processes import wait_until

ENDINGS = [
    ("raise SystemExit(3)", 3),
    ("raise SystemExit", 0),
    ("raise SystemExit('no')", 1),
    ("1 / 0", 1),
    ("import os; os.kill(os.getpid(), 9)", -signal.SIGKILL),
    ("raise KeyboardInterrupt", -signal.SIGINT),
    ("#!/bin/sh\ntest $COLOUR = red && exit 7", 7),
]
REPORT = """
import atexit, os, sys
atexit.register(print, "goodbye")
print(__name__, *sys.argv[1:], os.environ["COLOUR"], os.environ.get("HOME"))
print(os.getsid(0) == os.getpid(), sorted(os.listdir("/proc/self/fd"))[:4])
print("colorsys" in sys.modules, any(not path for path in sys.path))
"""
WAIT = "print('ready', flush=True)\nimport signal\nsignal.pause()"


@pytest.fixture(scope="module")
def preloaded() -> Iterator[Preloaded]:
    """Provide a process that has loaded little."""
    made = Preloaded(("no.such.module", "colorsys"), dict(os.environ))
    yield made
    made.close()


def start(preloaded: Preloaded, folder: Path, program: str, *arguments: str) -> Forked:
    """Run a program whose output goes to ``log``."""
    file = folder / "program"
    file.write_text(program if program.startswith("#!") else f"#!/usr/bin/env python3\n{program}")
    file.chmod(0o755)
    with (folder / "log").open("wb") as log:
        return preloaded.start([str(file), *arguments], stdout=log, env={"COLOUR": "red"})


def end_of(process: Forked) -> int:
    """Wait for the exit code."""
    wait_until(lambda: process.poll() is not None)
    code = process.poll()
    assert code is not None
    return code


def test_it_is_as_if_started_for_itself(preloaded: Preloaded, tmp_path: Path) -> None:
    assert end_of(start(preloaded, tmp_path, REPORT, "a", "b c")) == 0
    assert (tmp_path / "log").read_text().splitlines() == [
        "__main__ a b c red None",
        "True ['0', '1', '2', '3']",  # 3 is the listed folder
        "True False",
        "goodbye",
    ]


@pytest.mark.parametrize(("program", "code"), ENDINGS)
def test_it_ends_with_its_own_code(
    program: str, code: int, preloaded: Preloaded, tmp_path: Path
) -> None:
    assert end_of(start(preloaded, tmp_path, program)) == code
    assert ("ZeroDivisionError" in (tmp_path / "log").read_text()) is ("/ 0" in program)


def test_it_shows_its_own_command_line_and_takes_signals(
    preloaded: Preloaded, tmp_path: Path
) -> None:
    process = start(preloaded, tmp_path, WAIT, "x" * 10_000)
    wait_until(lambda: "ready" in (tmp_path / "log").read_text())
    line = psutil.Process(process.pid).cmdline()
    assert line[1] == str(tmp_path / "program")
    assert line[2].startswith("xxx")
    process.send_signal(signal.SIGINT)
    assert end_of(process) == -signal.SIGINT
    process.send_signal(signal.SIGINT)  # it has ended: nothing happens


def test_an_interrupt_that_comes_at_once_is_not_lost(preloaded: Preloaded, tmp_path: Path) -> None:
    process = start(preloaded, tmp_path, WAIT)
    process.send_signal(signal.SIGINT)
    assert end_of(process) == -signal.SIGINT


def test_children_are_ours_and_go_on_without_it(tmp_path: Path) -> None:
    preloaded = Preloaded(("colorsys",), dict(os.environ))
    process = start(preloaded, tmp_path, WAIT)
    assert psutil.Process(process.pid).ppid() == os.getpid()
    wait_until(lambda: "ready" in (tmp_path / "log").read_text())
    preloaded.close()
    with pytest.raises(OSError):
        start(preloaded, tmp_path, WAIT)
    assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    assert end_of(process) == -signal.SIGKILL
