# SPDX-License-Identifier: Apache-2.0
"""A plugin for pytest that keeps which lines each passing test runs, and how long it takes.

Lines count wherever they run, in the process of the test and in those that it starts: coverage.py
starts with every interpreter that has COVERAGE_PROCESS_START in its environment.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage, CoverageData
from coverage.exceptions import CoverageException

PACKAGE = "tactile_hand_ros"
# Names the test, or the fixture of several tests, for which a process was started.
_USER = "MUTATION_COVERAGE_OF"
_CHILDREN = f"""[run]
data_file = {{folder}}/lines
parallel = true
context = ${{{{{_USER}-}}}}
include = */{PACKAGE}/*
patch = _exit, fork
disable_warnings = no-data-collected, already-imported, couldnt-parse, trace-changed
"""

_durations: dict[str, float] = defaultdict(float)
_shared: dict[str, float] = {}  # seconds by fixture
_failed: set[str] = set()
_children = tempfile.TemporaryDirectory(prefix="mutate-lines-")
# In memory: tests fork, and two processes that share a file of results break it.
_coverage = Coverage(data_file=None, include=[f"*/{PACKAGE}/*"])


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that names the file to write."""
    parser.addoption("--lines-by-test", type=Path)


def pytest_configure() -> None:
    """Watch from before the package is imported."""
    settings = Path(_children.name, "settings")
    settings.write_text(_CHILDREN.format(folder=_children.name))
    os.environ["COVERAGE_PROCESS_START"] = str(settings)
    _coverage.start()


def pytest_runtest_logstart(nodeid: str) -> None:
    """Note what runs from now on for the test."""
    _note_for(nodeid)


def pytest_runtest_logfinish() -> None:
    """Note what runs between tests for none."""
    _note_for("")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> Generator[None, Any, Any]:
    """Note what a fixture of several tests runs, and the processes it starts, for all of them."""
    if fixturedef.scope == "function":
        return (yield)
    test, began = os.environ[_USER], time.monotonic()
    name = f"{request.node.nodeid} {fixturedef.argname}"
    _note_for(name)
    try:
        return (yield)
    finally:
        _note_for(test)
        _shared[name] = time.monotonic() - began
        _durations[test] -= _shared[name]


def _note_for(name: str) -> None:
    _coverage.switch_context(name)
    os.environ[_USER] = name


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up set-up, call and tear-down of a test."""
    _durations[report.nodeid] += report.duration
    if report.failed:
        _failed.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write tests by file and line, and durations [s] by test."""
    _coverage.stop()
    users = {name: list(_users(name, session.items)) for name in _shared}
    for name, tests in users.items():
        for test in tests:
            _durations[test] += _shared[name]
    passed = {item.nodeid: _durations[item.nodeid] for item in session.items}
    passed = {name: each for name, each in passed.items() if each and name not in _failed}
    found = _tests_by_line(Path(session.config.rootpath), set(passed), users)
    session.config.getoption("--lines-by-test").write_text(json.dumps([found, passed]))


def _users(name: str, items: Iterable[pytest.Item]) -> Iterator[str]:
    """Yield the tests that use a fixture."""
    place, _, fixture = name.rpartition(" ")
    for item in items:
        if item.nodeid.startswith(place) and fixture in getattr(item, "fixturenames", ()):
            yield item.nodeid


def _tests_by_line(
    root: Path, passed: set[str], users: dict[str, list[str]]
) -> dict[str, dict[int, list[str]]]:
    names: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    for data in (_coverage.get_data(), *_data_of_children()):
        for measured in map(Path, data.measured_files()):
            if not measured.is_relative_to(root):  # an installed executable
                continue
            path = str(measured.relative_to(root))
            for line, contexts in data.contexts_by_lineno(str(measured)).items():
                for each in contexts:
                    names[path][line].update(users.get(each, [each]))
    found: dict[str, dict[int, list[str]]] = defaultdict(dict)
    for path, by_line in names.items():
        every = passed & set[str]().union(*by_line.values())
        for line, of_line in by_line.items():
            # What only runs on import counts for every test of the file.
            if tests := passed & of_line or every:
                found[path][line] = sorted(tests)
    return found


def _data_of_children() -> Iterator[CoverageData]:
    for file in Path(_children.name).glob("lines.*"):
        data = CoverageData(str(file))
        with contextlib.suppress(CoverageException):  # of a process that was killed
            data.read()
            yield data
