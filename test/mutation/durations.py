# SPDX-License-Identifier: Apache-2.0
"""A plugin for pytest that keeps the duration of each test that passes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

_durations: dict[str, float] = {}
_failed: set[str] = set()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that names the file."""
    parser.addoption("--durations-file", type=Path)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up set-up, call and tear-down of a test."""
    _durations[report.nodeid] = _durations.get(report.nodeid, 0.0) + report.duration
    if report.failed:
        _failed.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the file."""
    passed = {name: each for name, each in _durations.items() if name not in _failed}
    session.config.getoption("--durations-file").write_text(json.dumps(passed))
