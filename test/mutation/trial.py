# SPDX-License-Identifier: Apache-2.0
"""Run the tests of one mutant in a process of its own."""

from __future__ import annotations

import compileall
import contextlib
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

from mutation.coverage_map import CoverageMap, environment, folder_of
from mutation.mutants import Mutant

# Loaded once by the server that forks the processes; the package itself is loaded in each.
_LIBRARIES = ["pytest", "numpy", "scipy.optimize", "scipy.spatial", "hypothesis", "pydantic"]
_COPIED = ("tactile_hand_ros", "test", "config", "docs", "scripts", "viewer", "resource")
_COPIED_FILES = ("pyproject.toml", "package.xml", "setup.py", "setup.cfg", "README.md", "Makefile")

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
        timeout = 10.0 + 5.0 * sum(tests.durations.get(name, 0.0) for name in names)
        try:
            with _changed(change, copy) if change else contextlib.nullcontext():
                return _passes(context, names, copy, folder, timeout)
        finally:
            copies.put(copy)

    def attempt(mutant: Mutant) -> Trial:
        names = _within(tests, mutant, budget)
        if not names:
            return Trial(mutant, UNCOVERED)
        has_passed = passes(names, folder_of(mutant.path), mutant)
        return Trial(mutant, SURVIVED if has_passed else KILLED)

    for folder in sorted({folder_of(each.path) for each in mutants}):
        own = [each for each in mutants if folder_of(each.path) == folder]
        unchanged = sorted({name for each in own for name in _within(tests, each, budget)})
        if unchanged and not passes(unchanged, folder):
            failing = [name for name in unchanged if not passes([name], folder)]
            raise RuntimeError(
                "the tests fail on the unchanged code, so that a failure would prove nothing: "
                f"{', '.join(failing) or 'together, but not alone'}"
            )
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


def _passes(
    context: multiprocessing.context.ForkServerContext,
    names: list[str],
    copy: Path,
    folder: str,
    timeout: float,
) -> bool:
    process = context.Process(target=_run_tests, args=(copy, folder, names, timeout))
    process.start()
    process.join(timeout)
    passed = process.exitcode == 0
    # Also what the tests started and a failure left behind.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(int(process.pid or 0), signal.SIGKILL)
    process.join()
    return passed


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


def _run_tests(copy: Path, folder: str, names: list[str], timeout: float) -> None:
    """Run tests quietly and end the process with pytest's answer."""
    os.setsid()
    os.chdir(copy)
    sys.dont_write_bytecode = True
    sys.path[:0] = [str(copy), str(copy / "test")]
    variables = environment(copy, folder)
    os.environ.clear()
    os.environ.update(variables)
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    import pytest

    options = ["-x", "-q", "-p", "no:cacheprovider", f"--timeout={timeout:.0f}"]
    code = pytest.main([*options, "-p", "no:faulthandler", *names])
    # Threads of a broken test must not keep the process alive.
    os._exit(int(code))
