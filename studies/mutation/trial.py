# SPDX-License-Identifier: Apache-2.0
"""Run the tests of one mutant in a process of its own, and end what they started."""

from __future__ import annotations

import compileall
import contextlib
import itertools
import multiprocessing
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from mutation.coverage_map import CoverageMap, environment, folder_of
from mutation.mutants import Mutant

# Loaded once by the server that forks the processes; the package itself is loaded in each.
_LIBRARIES = [
    *("pytest", "numpy", "scipy.optimize", "scipy.spatial", "hypothesis", "pydantic", "pinocchio"),
    *("rclpy.node", "rclpy.executors", "sensor_msgs.msg", "geometry_msgs.msg", "std_srvs.srv"),
    *("visualization_msgs.msg", "rcl_interfaces.srv", "rosbags.rosbag2", "rich.progress", "typer"),
]
_COPIED = (
    "tactile_hand_ros",
    "test",
    "bench",
    "studies",
    "config",
    "docs",
    "scripts",
    "viewer",
    "resource",
)
_COPIED_FILES = ("pyproject.toml", "package.xml", "setup.py", "setup.cfg", "README.md", "Makefile")

KILLED, SURVIVED, UNCOVERED = "killed", "survived", "uncovered"
# In the environment of a trial and of the processes that its tests start.
_MARK = "MUTATION_TRIAL"
_numbers = itertools.count()


@dataclass(frozen=True)
class Trial:
    """What became of a mutant.

    Attributes:
        mutant: The change.
        verdict: `killed`, also by a timeout; `survived`; `uncovered`: no test runs the line.
    """

    mutant: Mutant
    verdict: str


def run_trials(
    mutants: list[Mutant],
    tests: CoverageMap,
    root: Path,
    scratch: Path,
    jobs: int,
    budget: float,
    on_trial: Callable[[Trial], None],
) -> list[Trial]:
    """Try all mutants on several cores.

    Args:
        mutants: The changes to try.
        tests: Which tests to run for which line.
        root: The project.
        scratch: A folder for one copy of the project a core.
        jobs: Number of processes.
        budget: Time that the tests of a mutant may take without it [s]; slower ones are left out.
        on_trial: Called after each, in this process.
    """
    os.environ.update(environment(root, ""))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["mutation.trial", *_LIBRARIES])
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(jobs):
        copies.put(_copy(root, scratch / f"tree-{number}"))

    def failing(names: list[str], folder: str, change: Mutant | None = None) -> str | None:
        copy = copies.get()
        durations = {name: tests.durations.get(name, 0.0) for name in names}
        try:
            with _changed(change, copy) if change else contextlib.nullcontext():
                return _failing(context, durations, copy, folder)
        finally:
            copies.put(copy)

    unsound: dict[str, bool] = {}

    def is_sound(name: str, folder: str) -> bool:
        """Return whether a test passes on the unchanged code; else its failure proves nothing."""
        if name not in unsound:
            unsound[name] = failing([name], folder) is not None
            if unsound[name]:
                print(f"left out, fails on the unchanged code: {name}", flush=True)
        return not unsound[name]

    def attempt(mutant: Mutant) -> Trial:
        folder = folder_of(mutant.path)
        names = [name for name in _within(tests, mutant, budget) if not unsound.get(name)]
        while names:
            failed = failing(names, folder, mutant)
            if failed is None:
                return Trial(mutant, SURVIVED)
            if is_sound(failed or names[0], folder):
                return Trial(mutant, KILLED)
            names.remove(failed or names[0])
        return Trial(mutant, UNCOVERED)

    done = []
    with ThreadPoolExecutor(jobs) as pool:
        for trial in pool.map(attempt, mutants):
            on_trial(trial)
            done.append(trial)
    return done


def _within(tests: CoverageMap, mutant: Mutant, budget: float) -> list[str]:
    """Return the fastest tests of the line that together keep the budget, at least one."""
    names = tests.covering(mutant.path, mutant.line, bool(mutant.function))
    spent, chosen = 0.0, []
    for name in names:
        spent += tests.durations.get(name, 0.0)
        if chosen and spent > budget:
            break
        chosen.append(name)
    return chosen


def _copy(root: Path, to: Path) -> Path:
    shutil.rmtree(to, ignore_errors=True)
    to.mkdir(parents=True)
    for name in _COPIED:
        ignored = shutil.ignore_patterns("__pycache__", "node_modules")
        shutil.copytree(root / name, to / name, ignore=ignored)
    for name in _COPIED_FILES:
        shutil.copy2(root / name, to / name)
    # Compiled once; the processes that try mutants write nothing back.
    compileall.compile_dir(str(to / "tactile_hand_ros"), quiet=2)
    return to


def _failing(
    context: multiprocessing.context.ForkServerContext,
    durations: dict[str, float],
    copy: Path,
    folder: str,
) -> str | None:
    """Run tests until one fails: its name, empty if they hang or cannot begin, None if all pass."""
    limits = {name: 10.0 + 3.0 * each for name, each in durations.items()}
    mark = f"{os.getpid()}-{next(_numbers)}"
    said, says = context.Pipe(duplex=False)
    process = context.Process(target=_run_tests, args=(copy, folder, limits, mark, says))
    process.start()
    says.close()
    process.join(20.0 + 3.0 * sum(durations.values()))
    passed, failed = process.exitcode == 0, ""
    with contextlib.suppress(EOFError):  # it has said nothing and ended
        failed = said.recv() if said.poll() else ""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(int(process.pid or 0), signal.SIGKILL)
    process.join()
    _end_marked(mark)
    return None if passed else failed


def _end_marked(mark: str) -> None:
    """End what the tests started and a failure left behind in a session of its own."""
    entry = f"{_MARK}={mark}".encode()
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if entry in path.read_bytes().split(b"\0"):
                os.kill(int(path.parent.name), signal.SIGKILL)


@contextlib.contextmanager
def _changed(mutant: Mutant, copy: Path) -> Iterator[None]:
    """Change the file for a while, and remove its byte code, which would hide the change."""
    path = copy / mutant.path
    original = path.read_text(encoding="utf-8")
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()
    path.write_text(mutant.mutated(original), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(original, encoding="utf-8")


class _Limits:
    """A plugin for pytest: a time limit for each test [s], and the name of the one that fails."""

    def __init__(self, limits: dict[str, float], says: Connection) -> None:
        """Take the limits by the name of the test, and who wants to know which one fails."""
        self._limits, self._says = limits, says

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Say which test fails."""
        if report.failed:
            self._says.send(report.nodeid)

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Let tests that take a tenth of a second fail soon: a change often lets them hang."""
        for item in items:
            item.add_marker(pytest.mark.timeout(self._limits[item.nodeid]))


def _run_tests(
    copy: Path, folder: str, limits: dict[str, float], mark: str, says: Connection
) -> None:
    """Run tests quietly and end the process with pytest's answer."""
    os.setsid()
    os.chdir(copy)
    sys.dont_write_bytecode = True
    sys.path[:0] = [str(copy), str(copy / "test")]
    variables = environment(copy, folder)
    os.environ.clear()
    # Byte code that processes write would hide a change made in the same second.
    os.environ.update(variables | {_MARK: mark, "PYTHONDONTWRITEBYTECODE": "1"})
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:faulthandler"]
    code = pytest.main([*options, *limits], plugins=[_Limits(limits, says)])
    # Threads of a broken test must not keep the process alive.
    os._exit(int(code))
