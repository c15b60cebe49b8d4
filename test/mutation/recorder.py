# SPDX-License-Identifier: Apache-2.0
"""A plugin for pytest that keeps which lines each passing test runs, and how long it takes."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import pytest
from coverage import Coverage

PACKAGE = "tactile_hand_ros"

_durations: dict[str, float] = {}
_failed: set[str] = set()
# In memory: tests fork, and two processes that share a file of results break it.
_coverage = Coverage(data_file=None, include=[f"*/{PACKAGE}/*"])


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that names the file to write."""
    parser.addoption("--lines-by-test", type=Path)


def pytest_configure() -> None:
    """Watch from before the package is imported."""
    _coverage.start()


def pytest_runtest_logstart(nodeid: str) -> None:
    """Note what runs from now on for the test."""
    _coverage.switch_context(nodeid)


def pytest_runtest_logfinish() -> None:
    """Note what runs between tests for none."""
    _coverage.switch_context("")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up set-up, call and tear-down of a test."""
    _durations[report.nodeid] = _durations.get(report.nodeid, 0.0) + report.duration
    if report.failed:
        _failed.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write tests by file and line, and durations [s] by test."""
    _coverage.stop()
    passed = {name: each for name, each in _durations.items() if name not in _failed}
    found = _tests_by_line(Path(session.config.rootpath), set(passed))
    session.config.getoption("--lines-by-test").write_text(json.dumps([found, passed]))


def _tests_by_line(root: Path, passed: set[str]) -> dict[str, dict[int, list[str]]]:
    data = _coverage.get_data()
    found: dict[str, dict[int, list[str]]] = defaultdict(dict)
    for measured in data.measured_files():
        path = str(Path(measured).relative_to(root))
        by_line = data.contexts_by_lineno(measured)
        every = passed & {name for contexts in by_line.values() for name in contexts}
        for line, contexts in by_line.items():
            # What only runs on import counts for every test of the file.
            if tests := passed.intersection(contexts) or every:
                found[path][line] = sorted(tests)
    return found
