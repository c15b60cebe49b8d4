# SPDX-License-Identifier: Apache-2.0
"""Which tests run a line, measured once by coverage.py, and whether they notice a change of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from coverage import CoverageData
from mutation.mutants import Mutant

_COPIED = ("tactile_hand_ros", "test", "bench", "studies", "config", "docs", "scripts", "resource")
_FILES = ("pyproject.toml", "package.xml", "setup.py", "setup.cfg", "README.md", "Makefile")
# Inside machine code no line is seen to run, and no change seen.
_INTERPRETED = ("", "hand", "control", "simulation")
_SLOW = 20  # s, longest test that takes part
_QUIET = ["-q", "--tb=no", "-p", "no:cacheprovider"]

KILLED, SURVIVED, UNCOVERED = "killed", "survived", "uncovered"


@dataclass(frozen=True)
class Trial:
    """What became of a mutant.

    Attributes:
        mutant: The change.
        verdict: `killed`, also by a timeout; `survived`; `uncovered`: no test runs the line.
    """

    mutant: Mutant
    verdict: str


@dataclass(frozen=True)
class CoverageMap:
    """Tests by file and line, and how long each takes [s]; those that fail are left out.

    A test is named as in `test.unit.control.test_reach.test_name`, with all its parameters.
    """

    data: CoverageData
    root: Path
    durations: dict[str, float]

    def covering(self, mutant: Mutant, budget: float) -> list[str]:
        """Return the fastest tests of a line that together keep a budget [s], at least one.

        A line at the top of a module runs on import, in no test: all tests of the file count.
        """
        by_line = self.data.contexts_by_lineno(str(self.root / mutant.path))
        lines = [mutant.line] if mutant.function else list(by_line)
        names = {context for line in lines for context in by_line.get(line, ())}
        spent, chosen = 0.0, list[str]()
        for name in sorted(names & set(self.durations), key=lambda name: self.durations[name]):
            spent += self.durations[name]
            if chosen and spent > budget:
                break
            chosen.append(name)
        return chosen


def folder_of(path: str) -> str:
    """Return the folder of the package in which a file is, empty for a module beside them."""
    parts = Path(path).parts
    return parts[1] if len(parts) > 2 else ""


def environment(root: Path, folder: str) -> dict[str, str]:
    """Return the environment in which the tests of a folder import a tree."""
    made = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    return made | ({"TACTILE_HAND_INTERPRETED": "1"} if folder in _INTERPRETED else {})


def coverage_map(root: Path, folder: str, scratch: Path) -> CoverageMap:
    """Run the tests of a folder, and those of the laws, once each."""
    top = root / "test" / "unit"
    found = (top / folder).rglob("test_*.py") if folder else top.glob("test_*.py")
    suites = [str(path) for path in (*found, *(root / "test" / "property").glob("test_*.py"))]
    results, lines, settings = (scratch / name for name in ("results.xml", "lines", "settings"))
    settings.write_text("[run]\nsource = tactile_hand_ros\ndynamic_context = test_function\n")
    watched = ["-m", "coverage", "run", f"--rcfile={settings}", f"--data-file={lines}"]
    options = [*_QUIET, f"--timeout={_SLOW}", f"--junit-xml={results}"]
    command = [sys.executable, *watched, "-m", "pytest", *options, *suites]
    print(f"running the tests of '{folder}', to see which test runs which line", flush=True)
    variables = environment(root, folder)
    subprocess.run(command, cwd=root, env=variables, check=False, stdout=subprocess.DEVNULL)
    data = CoverageData(str(lines))
    data.read()
    return CoverageMap(data, root, _durations(results))


def _durations(results: Path) -> dict[str, float]:
    """Return the duration of each test that passes with all its parameters [s]."""
    found: dict[str, float] = defaultdict(float)
    failed = set()
    for case in ElementTree.parse(results).iter("testcase"):
        name = f"{case.get('classname')}.{str(case.get('name')).partition('[')[0]}"
        found[name] += float(case.get("time", 0.0))
        if case.find("failure") is not None or case.find("error") is not None:
            failed.add(name)
    return {name: seconds for name, seconds in found.items() if name not in failed}


def _node_id(name: str, root: Path) -> str:
    """Return what pytest calls a test."""
    parts = name.split(".")
    for count in range(len(parts) - 1, 0, -1):
        file = Path(*parts[:count]).with_suffix(".py")
        if (root / file).is_file():
            return "::".join([str(file), *parts[count:]])
    return name


def run_trials(
    mutants: list[Mutant],
    root: Path,
    scratch: Path,
    jobs: int,
    budget: float,
    on_trial: Callable[[Trial], None],
) -> None:
    """Try mutants on several cores, each in a copy of the project.

    Args:
        mutants: The changes to try.
        root: The project.
        scratch: A folder for the copies.
        jobs: Number of processes.
        budget: Time that the tests of a mutant may take without it [s]; slower ones are left out.
        on_trial: Called after each.
    """
    maps = {f: coverage_map(root, f, scratch) for f in {folder_of(m.path) for m in mutants}}
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(jobs):
        copies.put(_copy(root, scratch / f"tree-{number}"))

    def attempt(mutant: Mutant) -> Trial:
        folder = folder_of(mutant.path)
        tests = maps[folder].covering(mutant, budget)
        if not tests:
            return Trial(mutant, UNCOVERED)
        limit = 30.0 + 3.0 * sum(maps[folder].durations[name] for name in tests)
        copy = copies.get()
        try:
            if _fails(tests, copy, folder, limit):  # its failure would prove nothing
                return Trial(mutant, UNCOVERED)
            with _changed(mutant, copy):
                fails = _fails(tests, copy, folder, limit)
        finally:
            copies.put(copy)
        return Trial(mutant, KILLED if fails else SURVIVED)

    with ThreadPoolExecutor(jobs) as pool:
        for trial in pool.map(attempt, mutants):
            on_trial(trial)


def _copy(root: Path, to: Path) -> Path:
    ignored = shutil.ignore_patterns("__pycache__", "node_modules")
    for name in _COPIED:
        shutil.copytree(root / name, to / name, ignore=ignored)
    for name in _FILES:
        shutil.copy2(root / name, to / name)
    return to


@contextlib.contextmanager
def _changed(mutant: Mutant, copy: Path) -> Iterator[None]:
    """Change the file for a while."""
    path = copy / mutant.path
    original = path.read_text(encoding="utf-8")
    path.write_text(mutant.mutated(original), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(original, encoding="utf-8")


def _fails(tests: list[str], copy: Path, folder: str, limit: float) -> bool:
    """Return whether a test fails, or hangs; what it has started is ended."""
    command = [sys.executable, "-m", "pytest", "-x", *_QUIET]
    command += [_node_id(name, copy) for name in tests]
    with subprocess.Popen(
        command,
        cwd=copy,
        env=environment(copy, folder),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            return process.wait(limit) != 0
        except subprocess.TimeoutExpired:
            return True
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
