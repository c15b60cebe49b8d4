# SPDX-License-Identifier: Apache-2.0
"""Which test runs which line, and how long it takes: measured once and kept."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Container, Mapping
from dataclasses import dataclass
from pathlib import Path

# Slower tests, with coverage and often without compilation, are left out [s].
_SLOW = 20
# Folders whose tests start nodes, and which tests of `test/integration` are about others.
_INTEGRATED = {
    **dict.fromkeys(("ros", "nodes", "orchestrator"), "test_*.py"),
}
_OF_OTHERS = ("test_bench_runs", "test_faults", "test_packaging", "test_sweep")
_RECORDER = "studies/mutation/recorder.py"
# Which of `test/property` are about a folder.
_LAWS = {
    "control": ("optimizer", "thin_plates"),
    "simulation": ("contact_problems", "coulomb", "solid"),
    **dict.fromkeys(("bag", "config", "closed_loop"), ("hostile_files",)),
    **dict.fromkeys(("ros", "nodes", "orchestrator"), ("hostile_files", "hostile_messages")),
}
# Tests of other folders that look closely at this one.
_ELSEWHERE = {
    "hand": ("control/test_reach_cost", "simulation/test_calibration"),
    "closed_loop": ("control/test_own_law", "simulation/test_calibration"),
}
# What was compiled from this tree; changes of what is not compiled leave it as it is.
_COMPILED = Path(__file__).resolve().parents[2] / ".mutation" / "compiled"
_FAILED = re.compile("(FAILED|ERROR) test/")
_OWN_VARIABLES = ("TACTILE_HAND_INTERPRETED", "NUMBA_CACHE_DIR", "PYTHONPATH")


@dataclass(frozen=True)
class CoverageMap:
    """Tests by line.

    Attributes:
        tests: Node ids of the tests that run a line, by file and line.
        durations: Duration of each test [s].
    """

    tests: dict[str, dict[int, list[str]]]
    durations: dict[str, float]

    def covering(self, path: str, line: int, in_function: bool) -> list[str]:
        """Return the tests that run a line, the fastest first.

        A line at the top of a module runs on import, in no test: all tests that run any line of the
        file count, and those that mirror it, since a file of declarations has no other lines.
        """
        lines = self.tests.get(path, {})
        mirror = Path("test/unit", *Path(path).parts[1:-1], f"test_{Path(path).name}::")
        every = {test for tests in lines.values() for test in tests}
        every |= {test for test in self.durations if test.startswith(str(mirror))}
        found = lines.get(line, []) if in_function else every
        return sorted(found, key=lambda test: (self.durations.get(test, 0.0), test))


def coverage_map(root: Path, folders: set[str], cache: Path) -> CoverageMap:
    """Run the tests of some folders once each, or load what an earlier run found.

    Args:
        root: The project.
        folders: Folders of the package, such as `control`; `""` for the modules beside them.
        cache: Where the answers are kept: a file for each file of tests. A change of a test costs
            its file, a change of the sources all of them.
    """
    cache.mkdir(parents=True, exist_ok=True)
    common = _digest_of_sources(root)
    whole = CoverageMap({}, {})
    for folder in sorted(folders):
        kept = {test: cache / _name(root, test, folder, common) for test in _suites(root, folder)}
        missing = [test for test in kept if not kept[test].is_file()]
        if missing:
            _warm_up(root, folder)
        for group in _groups(missing):
            _measure(root, folder, group, kept)
        for file in kept.values():
            if file.is_file():
                _add(whole, folder, *json.loads(file.read_text()))
    return whole


def _groups(suites: list[str]) -> list[list[str]]:
    """Return files of tests to run together; those that start processes run, and fail, alone."""
    alone = [each for each in suites if each.startswith("test/integration/")]
    together = [each for each in suites if each not in alone]
    return [together] * bool(together) + [[each] for each in alone]


def _add(
    whole: CoverageMap,
    folder: str,
    tests: Mapping[str, Mapping[str, list[str]]],
    durations: Mapping[str, float],
) -> None:
    whole.durations.update(durations)
    for path, lines in tests.items():
        if folder_of(path) == folder:
            known = whole.tests.setdefault(path, {})
            for line, names in lines.items():
                known.setdefault(int(line), []).extend(names)


def folder_of(path: str) -> str:
    """Return the folder of the package in which a file is, empty for a module beside them."""
    parts = Path(path).parts
    return parts[1] if len(parts) > 2 else ""


def _suites(root: Path, folder: str) -> list[str]:
    """Return the files of tests of a folder."""
    top = root / "test/unit"
    mirrored = (top / folder).rglob("test_*.py") if folder else top.glob("test_*.py")
    laws = [root / f"test/property/test_{name}.py" for name in _LAWS.get(folder, ())]
    started = _INTEGRATED.get(folder)
    integrated = (root / "test/integration").glob(started) if started else ()
    elsewhere = [top / f"{name}.py" for name in _ELSEWHERE.get(folder, ())]
    found = [*mirrored, *laws, *integrated, *elsewhere]
    return sorted(str(path.relative_to(root)) for path in found if path.stem not in _OF_OTHERS)


def _digest_of_sources(root: Path) -> bytes:
    digest = hashlib.sha256()
    for folder in ("tactile_hand_ros", "config", "test/support", "test/conftest.py", _RECORDER):
        above = root / folder
        for path in sorted(above.rglob("*")) if above.is_dir() else [above]:
            if path.suffix in (".py", ".yaml", ".urdf"):
                digest.update(path.read_bytes())
    return digest.digest()


def _name(root: Path, test: str, folder: str, common: bytes) -> str:
    mode = b"interpreted" if is_interpreted(folder) else b"compiled"
    digest = hashlib.sha256(common + mode + test.encode() + (root / test).read_bytes())
    return f"{Path(test).stem}-{digest.hexdigest()[:16]}.json"


def is_interpreted(folder: str) -> bool:
    """Return whether the tests of a folder run without compilation.

    No line is seen to run, and no change seen, inside machine code.
    """
    return folder in ("", "hand", "control", "simulation")


def environment(root: Path, folder: str) -> dict[str, str]:
    """Return the environment in which tests import the tree instead of the installed package.

    So do the processes that they start: the installed executables only import.
    """
    made = {name: value for name, value in os.environ.items() if name not in _OWN_VARIABLES}
    made["PYTHONPATH"] = os.pathsep.join([str(root), str(root / "test"), str(root / "studies")])
    if is_interpreted(folder):
        return made | {"TACTILE_HAND_INTERPRETED": "1"}
    return made | {"NUMBA_CACHE_DIR": str(_COMPILED)}


def _warm_up(root: Path, folder: str) -> None:
    """Compile what the tests of a folder need compiled."""
    if not is_interpreted(folder):
        command = [sys.executable, "-m", "tactile_hand_ros.closed_loop.warm_up"]
        subprocess.run(command, cwd=root, env=environment(root, folder), check=False)


def _measure(root: Path, folder: str, suites: list[str], kept: Mapping[str, Path]) -> None:
    """Run files of tests, and keep for each of them its tests by line and their durations.

    Tests that fail, in time or on a busy computer, are named and left out: they prove nothing.
    """
    name = suites[0] if len(suites) == 1 else f"{len(suites)} files of tests"
    print(f"running {name}, to see which test runs which line", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        to = Path(scratch) / "lines.json"
        command = [
            *(sys.executable, "-m", "pytest", "-q", "--tb=no", *suites, "-p", "no:cacheprovider"),
            *("-p", "mutation.recorder", f"--lines-by-test={to}", f"--timeout={_SLOW}"),
        ]
        variables = environment(root, folder)
        ended = subprocess.run(
            command, cwd=root, env=variables, check=False, capture_output=True, text=True
        )
        lines = ended.stdout.strip().splitlines()
        for line in filter(_FAILED.match, lines):
            print(f"left out: {line}", flush=True)
        if ended.returncode not in (0, 1) or not to.is_file():
            said = ended.stdout[-2000:] + ended.stderr[-2000:]
            print(f"left out: {', '.join(suites)}: they cannot run: {said}", flush=True)
            return
        print(lines[-1], flush=True)
        tests, durations = json.loads(to.read_text())
    tests = {path: _whole_statements(root / path, lines) for path, lines in tests.items()}
    for suite in suites:
        mine = {name: each for name, each in durations.items() if name.startswith(f"{suite}::")}
        by_path = {path: _of_suite(by_line, mine) for path, by_line in tests.items()}
        kept[suite].write_text(json.dumps([by_path, mine]))


def _whole_statements(source: Path, by_line: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Return the tests by line, where a test that runs a line of a statement runs all of them.

    Python does not report every line of a statement that stands on several.
    """
    found = {line: set(names) for line, names in by_line.items()}
    for node in ast.walk(ast.parse(source.read_bytes())):
        if isinstance(node, ast.stmt):
            body, end = getattr(node, "body", None), node.end_lineno or node.lineno
            last = max(body[0].lineno - 1, node.lineno) if body else end
            lines = [str(line) for line in range(node.lineno, last + 1)]
            # A function is defined on import; its defaults count where it runs.
            where = range(node.lineno, (end if isinstance(node, ast.FunctionDef) else last) + 1)
            names = set[str]().union(*(found.get(str(line), ()) for line in where))
            found |= dict.fromkeys(lines, names) if names else {}
    return {line: sorted(names) for line, names in found.items()}


def _of_suite(by_line: Mapping[str, list[str]], mine: Container[str]) -> dict[str, list[str]]:
    found = {line: [name for name in names if name in mine] for line, names in by_line.items()}
    return {line: names for line, names in found.items() if names}
