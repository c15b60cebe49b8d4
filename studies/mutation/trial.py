# SPDX-License-Identifier: Apache-2.0
"""Find the tests of a line with coverage.py, and check whether they kill a mutant of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from coverage import CoverageData

from studies.mutation.mutants import Mutant

_LEFT_OUT = (".venv", ".git", "__pycache__", "node_modules", "runs", ".*_cache", "build")
# Compiled code has no coverage, and its cache would hide a change.
_INTERPRETED = ("", "hand", "control", "simulation")
_SLOW = 20.0  # s, maximum duration of a test
_QUIET = ["-q", "--tb=no", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=0"]

KILLED, SURVIVED, UNCOVERED = "killed", "survived", "uncovered"


@dataclass(frozen=True)
class CoverageMap:
    """Tests by file and line, and the duration of each [s]; failing tests are excluded.

    A name such as `test.unit.control.test_reach.test_name` covers all parameters of the test.
    """

    data: CoverageData
    tree: Path
    durations: dict[str, float]

    def covering(self, mutant: Mutant, budget: float) -> list[str]:
        """Return the fastest tests of a line within a time budget [s], at least one.

        A line at the top of a module runs on import, so all tests of the file count.
        """
        by_line = self.data.contexts_by_lineno(str(self.tree / mutant.path))
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
    """Return the package folder of a file, empty at the top of the package."""
    return "/".join(Path(path).parts[1:-1])


def _environment(tree: Path, folder: str) -> dict[str, str]:
    """Return the environment for the tests of a folder in a tree."""
    made = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    is_plain = folder.partition("/")[0] in _INTERPRETED
    return made | ({"TACTILE_HAND_INTERPRETED": "1"} if is_plain else {})


def coverage_map(tree: Path, folder: str, scratch: Path, jobs: int) -> CoverageMap:
    """Run the tests of a folder, and the property tests that import from it, once."""
    top, module = tree / "test" / "unit", f"tactile_hand_ros.{folder.replace('/', '.')}"
    found = list((top / folder).rglob("test_*.py") if folder else top.glob("test_*.py"))
    laws = (tree / "test" / "property").glob("test_*.py")
    suites = [*found, *(path for path in laws if module in path.read_text())]
    settings, name = scratch / "coverage.cfg", folder.replace("/", "-")
    settings.write_text("[run]\nsource = tactile_hand_ros\ndynamic_context = test_function\n")
    print(f"measuring the coverage of the tests of '{folder}'", flush=True)

    def run(suite: Path) -> tuple[CoverageData, dict[str, float]]:
        results, lines = (scratch / f"{name}-{suite.stem}.{end}" for end in ("xml", "lines"))
        watched = ["-m", "coverage", "run", f"--rcfile={settings}", f"--data-file={lines}"]
        # A test of Hypothesis that runs into its time limit can stop pytest altogether.
        options = [*_QUIET, "--timeout=600", f"--junit-xml={results}"]
        command = [sys.executable, *watched, "-m", "pytest", *options, str(suite)]
        variables = _environment(tree, folder)
        subprocess.run(command, cwd=tree, env=variables, check=False, stdout=subprocess.DEVNULL)
        data = CoverageData(str(lines))
        data.read()
        return data, _durations(results)

    merged, durations = CoverageData(no_disk=True), dict[str, float]()
    with ThreadPoolExecutor(jobs) as pool:
        for data, lasted in pool.map(run, suites):
            merged.update(data)
            durations |= lasted
    return CoverageMap(merged, tree, durations)


def _durations(results: Path) -> dict[str, float]:
    """Return the duration [s] of each test that passes with all its parameters."""
    found: dict[str, float] = defaultdict(float)
    failed = set()
    for case in ElementTree.parse(results).iter("testcase"):
        name = f"{case.get('classname')}.{str(case.get('name')).partition('[')[0]}"
        found[name] += float(case.get("time", 0.0))
        if case.find("failure") is not None or case.find("error") is not None:
            failed.add(name)
    slow = {name for name, seconds in found.items() if seconds > _SLOW}
    return {name: found[name] for name in found.keys() - failed - slow}


def _node_id(name: str, tree: Path) -> str:
    """Return the pytest node id of a test."""
    parts = name.split(".")
    for count in range(len(parts) - 1, 0, -1):
        file = Path(*parts[:count]).with_suffix(".py")
        if (tree / file).is_file():
            return "::".join([str(file), *parts[count:]])
    return name


def run_trials(
    mutants: list[Mutant],
    root: Path,
    scratch: Path,
    jobs: int,
    budget: float,
    on_trial: Callable[[Mutant, str], None],
) -> None:
    """Test mutants on several cores, each in a copy of the project.

    Args:
        mutants: The mutants.
        root: The project.
        scratch: Folder for the copies.
        jobs: Number of processes.
        budget: Maximum time of a mutant's tests without it [s]; slower tests are skipped.
        on_trial: Called with each mutant and its verdict: killed, also by a timeout; survived; or
            uncovered if no test runs the line.
    """
    ignored, trees = shutil.ignore_patterns(*_LEFT_OUT), SimpleQueue[Path]()
    for number in range(jobs):
        trees.put(shutil.copytree(root, scratch / f"tree-{number}", ignore=ignored))
    first = scratch / "tree-0"
    folders = {folder_of(mutant.path) for mutant in mutants}
    maps = {folder: coverage_map(first, folder, scratch, jobs) for folder in folders}

    def attempt(mutant: Mutant) -> str:
        folder = folder_of(mutant.path)
        tests = maps[folder].covering(mutant, budget)
        if not tests:
            return UNCOVERED
        limit = 30.0 + 3.0 * sum(maps[folder].durations[name] for name in tests)
        tree = trees.get()
        file = tree / mutant.path
        original = file.read_text(encoding="utf-8")
        try:
            file.write_text(mutant.mutated(original), encoding="utf-8")
            return KILLED if _fails(tests, tree, folder, limit) else SURVIVED
        finally:
            file.write_text(original, encoding="utf-8")
            trees.put(tree)

    with ThreadPoolExecutor(jobs) as pool:
        for mutant, verdict in zip(mutants, pool.map(attempt, mutants), strict=True):
            on_trial(mutant, verdict)


def _fails(tests: list[str], tree: Path, folder: str, limit: float) -> bool:
    """Return whether a test fails or hangs; then end all its processes."""
    command = [sys.executable, "-m", "pytest", "-x", *_QUIET]
    command += [_node_id(name, tree) for name in tests]
    with subprocess.Popen(
        command,
        cwd=tree,
        env=_environment(tree, folder),
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
