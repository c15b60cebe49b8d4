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
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from mutation.coverage_map import CoverageMap, environment, folder_of
from mutation.mutants import Mutant

# Loaded once by the server that forks the processes; the package itself is loaded in each.
_LIBRARIES = ["pytest", "numpy", "scipy.optimize", "scipy.spatial", "hypothesis", "pydantic"]
_COPIED = ("tactile_hand_ros", "test", "config", "docs", "scripts", "viewer", "resource")
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

    Raises:
        RuntimeError: If the tests fail on the unchanged code.
    """
    os.environ.update(environment(root, ""))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["mutation.trial", *_LIBRARIES])
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(jobs):
        copies.put(_copy(root, scratch / f"tree-{number}"))

    def passes(names: list[str], folder: str, change: Mutant | None = None) -> bool:
        copy = copies.get()
        durations = {name: tests.durations.get(name, 0.0) for name in names}
        try:
            with _changed(change, copy) if change else contextlib.nullcontext():
                return _passes(context, durations, copy, folder)
        finally:
            copies.put(copy)

    def attempt(mutant: Mutant) -> Trial:
        names = _within(tests, mutant, budget)
        if not names:
            return Trial(mutant, UNCOVERED)
        has_passed = passes(names, folder_of(mutant.path), mutant)
        return Trial(mutant, SURVIVED if has_passed else KILLED)

    def check(names: list[str], folder: str) -> None:
        if passes(names, folder):
            return
        failing = [name for name in names if not passes([name], folder)]
        raise RuntimeError(
            "the tests fail on the unchanged code, so that a failure would prove nothing: "
            f"{', '.join(failing) or 'together, but not alone'}"
        )

    done = []
    with ThreadPoolExecutor(jobs) as pool:
        unchanged = _by_file(tests, mutants, budget)
        for _ in pool.map(check, unchanged.values(), (folder for _, folder in unchanged)):
            pass
        for trial in pool.map(attempt, mutants):
            on_trial(trial)
            done.append(trial)
    return done


def _by_file(
    tests: CoverageMap, mutants: list[Mutant], budget: float
) -> dict[tuple[str, str], list[str]]:
    """Return the tests of all mutants by their file and the folder of what they test."""
    found: dict[tuple[str, str], set[str]] = {}
    for mutant in mutants:
        for name in _within(tests, mutant, budget):
            place = name.partition("::")[0], folder_of(mutant.path)
            found.setdefault(place, set()).add(name)
    return {place: sorted(names) for place, names in sorted(found.items())}


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


def _passes(
    context: multiprocessing.context.ForkServerContext,
    durations: dict[str, float],
    copy: Path,
    folder: str,
) -> bool:
    limits = {name: 10.0 + 3.0 * each for name, each in durations.items()}
    mark = f"{os.getpid()}-{next(_numbers)}"
    process = context.Process(target=_run_tests, args=(copy, folder, limits, mark))
    process.start()
    process.join(20.0 + 3.0 * sum(durations.values()))
    passed = process.exitcode == 0
    with contextlib.suppress(ProcessLookupError):
        os.killpg(int(process.pid or 0), signal.SIGKILL)
    process.join()
    _end_marked(mark)
    return passed


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
    """A plugin for pytest that gives each test a time limit of its own [s]."""

    def __init__(self, limits: dict[str, float]) -> None:
        """Take them by the name of the test."""
        self._limits = limits

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Let tests that take a tenth of a second fail soon: a change often lets them hang."""
        for item in items:
            item.add_marker(pytest.mark.timeout(self._limits[item.nodeid]))


def _run_tests(copy: Path, folder: str, limits: dict[str, float], mark: str) -> None:
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
    code = pytest.main([*options, *limits], plugins=[_Limits(limits)])
    # Threads of a broken test must not keep the process alive.
    os._exit(int(code))
