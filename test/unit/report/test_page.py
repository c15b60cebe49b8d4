# SPDX-License-Identifier: Apache-2.0
"""The page is self-contained and has the numbers of the run."""

import json
import re
from pathlib import Path

import pytest
from support.recorded import random_record, write_record

from tactile_hand_ros.cli import app as cli
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.report.document import run_document
from tactile_hand_ros.report.page import write_report
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(write_record(tmp_path / "bag", random_record(40)))


class TestPage:
    def test_is_readable_as_json_whatever_a_bag_says(self, tmp_path: Path) -> None:
        evil = "</script><script>alert(1)</script><!-- \u2028 & \"'"
        scenario = load_scenario("paper").model_copy(update={"description": evil, "name": evil})
        told = {"scenario": resolved(scenario)}
        bag = write_record(tmp_path / "bag", random_record(5), custom_data=told)
        text = write_report(Run(bag)).read_text(encoding="utf-8")
        [document] = re.findall('id="document">(.*?)</script>', text, re.DOTALL)
        assert json.loads(document)["runs"][0]["description"] == evil

    def test_of_ten_seconds_is_small(self, run: Run) -> None:
        record = random_record(5001)
        run.__dict__ |= {"record": record, "latencies": record.grasp_force}  # as if read
        assert run_document(run)["shown"] == 5001
        assert write_report(run).stat().st_size < 5_000_000

    def test_does_not_name_the_folder_of_the_run(self, run: Run, tmp_path: Path) -> None:
        assert str(tmp_path) not in write_report(run).read_text(encoding="utf-8")

    def test_cannot_be_written_over_a_folder(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "report.html").mkdir()
        with pytest.raises(TactileHandError, match="cannot be written"):
            write_report(run, tmp_path)


class TestCommands:
    def test_report_writes_beside_the_bag(
        self, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert cli.main(["report", str(tmp_path)]) == 0
        assert (tmp_path / "report.html").is_file()
        out = capsys.readouterr().out
        assert str(tmp_path / "report.html") in out.replace("\n", "") and " MB" in out
