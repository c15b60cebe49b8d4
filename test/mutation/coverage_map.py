# SPDX-License-Identifier: Apache-2.0
"""Which test runs which line, and how long it takes: measured once and kept."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

# Slower tests, without compilation and with coverage, are left out [s].
_SLOW = 15


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

        A line at the top of a module runs on import, in no test: all tests of the file count.
        """
        lines = self.tests.get(path, {})
        found = lines.get(line, [])
        if not found and not in_function:
            found = sorted({test for tests in lines.values() for test in tests})
        return sorted(found, key=lambda test: (self.durations.get(test, 0.0), test))


def coverage_map(root: Path, folders: set[str], cache: Path) -> CoverageMap:
    """Run the tests of some folders once each, or load what an earlier run found.

    Args:
        root: The project.
        folders: Folders of the package, such as `control`; `""` for the modules beside them.
        cache: Where the answers are kept, by the digest of sources and tests.
    """
    cache.mkdir(parents=True, exist_ok=True)
    whole = CoverageMap({}, {})
    for folder in sorted(folders):
        kept = cache / f"{folder or 'top'}-{_digest(root)}.json"
        if not kept.is_file():
            _measure(root, folder, kept)
        tests, durations = json.loads(kept.read_text())
        for path, lines in tests.items():
            if folder_of(path) == folder:
                whole.tests[path] = {int(line): names for line, names in lines.items()}
        whole.durations.update(durations)
    return whole


def folder_of(path: str) -> str:
    """Return the folder of the package in which a file is, empty for a module beside them."""
    parts = Path(path).parts
    return parts[1] if len(parts) > 2 else ""


def _suites(root: Path, folder: str) -> list[str]:
    """Return the tests of a folder. Real processes load the installed, unchanged package."""
    if not folder:
        return sorted(str(path.relative_to(root)) for path in root.glob("test/unit/test_*.py"))
    mirrored = [f"test/unit/{folder}"] if (root / "test/unit" / folder).is_dir() else []
    return [*mirrored, "test/property"]


def _digest(root: Path) -> str:
    digest = hashlib.sha256()
    for folder in ("tactile_hand_ros", "test", "config"):
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in (".py", ".yaml", ".urdf") and "mutation" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def environment(root: Path) -> dict[str, str]:
    """Return the environment in which tests import the tree instead of the installed package."""
    paths = os.pathsep.join([str(root), str(root / "test")])
    return {**os.environ, "PYTHONPATH": paths, "TACTILE_HAND_INTERPRETED": "1"}


def _measure(root: Path, folder: str, to: Path) -> None:
    """Write the tests by file and line, and their durations."""
    suites = _suites(root, folder)
    print(f"running {' '.join(suites)} once, to see which test runs which line", flush=True)
    command = [
        *(sys.executable, "-m", "pytest", "-q", "--tb=no", *suites, "-p", "no:cacheprovider"),
        *("-p", "mutation.recorder", f"--lines-by-test={to}", f"--timeout={_SLOW}"),
    ]
    ended = subprocess.run(
        command, cwd=root, env=environment(root), check=False, capture_output=True, text=True
    )
    # 1: some tests were slow, or need compiled functions. They are left out.
    if ended.returncode not in (0, 1) or not to.is_file():
        raise RuntimeError(f"the tests cannot run: {ended.stdout[-2000:]}{ended.stderr[-2000:]}")
    print(ended.stdout.strip().splitlines()[-1], flush=True)
