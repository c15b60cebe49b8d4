# SPDX-License-Identifier: Apache-2.0
"""A run ends with its report, and a report that fails does not cost the run."""

from __future__ import annotations

from pathlib import Path

from support.recorded import random_record, write_record

from tactile_hand_ros.orchestrator.results.reading import Results
from tactile_hand_ros.orchestrator.results.report import report_line
from tactile_hand_ros.run.run import Run


def test_it_says_where_the_report_is(tmp_path: Path) -> None:
    write_record(tmp_path / "bag", random_record(5))
    line = report_line(Results(run=Run(tmp_path)))
    assert line == f"report: {tmp_path / 'report.html'}"
    assert (tmp_path / "report.html").is_file()


def test_without_a_bag_there_is_nothing_to_say() -> None:
    assert report_line(Results()) == ""


def test_what_goes_wrong_is_one_sentence(tmp_path: Path) -> None:
    write_record(tmp_path / "bag", random_record(5))
    (tmp_path / "report.html").mkdir()
    line = report_line(Results(run=Run(tmp_path)))
    assert line.startswith("the report was not written: ") and "\n" not in line
