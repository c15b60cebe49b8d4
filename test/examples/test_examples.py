# SPDX-License-Identifier: Apache-2.0
"""Every script in examples/ runs as a user runs it, and prints its result."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.recorded import write_record

from bench.processes import start_executable
from tactile_hand_ros import load_scenario, simulate
from tactile_hand_ros.scenario.scenario import resolved

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATIENCE = 240.0  # s

# What the output of each script must match.
PRINTED = {
    "solve_grasp.py": r"solved, optimality residual .*\nthumb +normal 0\.500, .*\nnet force .*e-1",
    "plot_grasp_force.py": r"on: goal reached, .*\n.*off: object dropped at .*\ngrasp_force\.png",
    "own_law.py": r"optimal: at most 1\d\d mm/s, 0.*\nGentleLaw: at most \d\d mm/s, 0\.",
    "own_object.py": r"0\.15 kg: goal reached, .*\n2\.4 kg: .*\nreport\.html",
    "read_bag.py": r"61 ticks, .*\nmax .*\ngrasp force k_f, N\n",
    "drive_by_topic.py": r"the grasp is at \(-?0\.0000, 0\.043[567], 0\.411[789]\) m",
}


@pytest.fixture
def needed(request: pytest.FixtureRequest, tmp_path: Path, domain: int) -> Iterator[None]:
    """Provide what a script finds: a run to read, or a hand to drive."""
    name = request.getfixturevalue("name")
    if name == "read_bag.py":
        short = {"duration": 0.12}
        scenario = {"scenario": resolved(load_scenario("paper", short))}
        record = simulate("paper", short).record
        write_record(tmp_path / "runs" / "latest" / "bag", record, custom_data=scenario)
    if name != "drive_by_topic.py":
        yield
        return
    words = ("paper", "--interactive", "--out", str(tmp_path / "runs"), "--set", "targets=[]")
    with start_executable("orchestrator", *words) as hand:
        hand.wait_for_output("t = ", PATIENCE)
        yield


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.py")))
@pytest.mark.usefixtures("needed")
def test_an_example_runs_and_prints_its_result(name: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / name],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(PRINTED[name], done.stdout, re.S), done.stdout
    assert len((EXAMPLES / name).read_text().splitlines()) < 40
