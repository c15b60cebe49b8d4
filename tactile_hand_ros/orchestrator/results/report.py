# SPDX-License-Identifier: Apache-2.0
"""The report at the end of a run: where it is, and how to see it."""

from __future__ import annotations

import webbrowser

from tactile_hand_ros.orchestrator.results.reading import Results
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.report.page import REPORT, write_report


def report_line(results: Results) -> str:
    """Write the report and return a line that says where it is, empty where nothing was recorded.

    A page that fails must not cost the run: whatever goes wrong is said and nothing else happens.
    """
    if results.run is None:
        return ""
    try:
        return f"report: {write_report(results.run)}"
    except Exception as error:
        return f"the report was not written: {error or type(error).__name__}"


def open_report(directory: RunDirectory) -> str:
    """Open the report in a browser and return a line that says so, or what to do instead."""
    file = (directory.path / REPORT).resolve()
    if not file.is_file():
        return "there is no report to open"
    if webbrowser.open(file.as_uri()):
        return f"opened {file.as_uri()}"
    return f"no browser was found here; open {file.as_uri()} in one"
