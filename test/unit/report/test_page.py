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


def test_it_is_readable_as_json_whatever_a_bag_says(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><!-- \u2028 & \"'"
    scenario = load_scenario("paper").model_copy(update={"description": evil, "name": evil})
    told = {"scenario": resolved(scenario)}
    bag = write_record(tmp_path / "bag", random_record(5), custom_data=told)
    text = write_report(Run(bag)).read_text(encoding="utf-8")
    [document] = re.findall('id="document">(.*?)</script>', text, re.DOTALL)
    assert json.loads(document)["runs"][0]["description"] == evil


def test_of_ten_seconds_it_is_small_and_written_whole(run: Run, tmp_path: Path) -> None:
    record = random_record(5001)
    run.__dict__ |= {"record": record, "latencies": record.grasp_force}  # as if read
    assert run_document(run)["shown"] == 5001
    file = write_report(run)
    assert file.stat().st_size < 5_000_000
    assert str(tmp_path) not in file.read_text(encoding="utf-8")
    file.unlink()
    file.mkdir()
    with pytest.raises(TactileHandError, match="cannot be written"):
        write_report(run)


@pytest.mark.usefixtures("run")
def test_the_command_writes_it_beside_the_bag(tmp_path, capsys) -> None:
    assert cli.main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").is_file()
    out = capsys.readouterr().out
    assert str(tmp_path / "report.html") in out.replace("\n", "") and " MB" in out
