# SPDX-License-Identifier: Apache-2.0
"""Every script in examples/ runs as a user runs it, and prints its result."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.recorded import write_record

from bench.processes import start_executable
from tactile_hand_ros import load_scenario, simulate
from tactile_hand_ros.scenario.scenario import resolved

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATIENCE = 240.0  # s
DRIVES = "drive_by_topic.py"

# What the output of each script must match.
PRINTED = {
    "solve_grasp.py": r"solved, optimality residual .*\nthumb +normal 0\.500, .*\nnet force .*e-1",
    "plot_grasp_force.py": r"on: goal reached, .*\n.*off: object dropped at .*\ngrasp_force\.png",
    "own_law.py": r"optimal: at most 1\d\d mm/s, 0.*\nGentleLaw: at most \d\d mm/s, 0\.",
    "own_object.py": r"0\.15 kg: goal reached, .*\n2\.4 kg: .*\nreport\.html",
    "read_bag.py": r"61 ticks, .*\nmax .*\ngrasp force k_f, N\n",
    "drive_by_topic.py": r"the grasp is at \(-?0\.0000, 0\.043[567], 0\.411[789]\) m",
}


def check(name: str, folder: Path) -> None:
    """Run a script in a folder."""
    done = subprocess.run(
        [sys.executable, EXAMPLES / name],
        cwd=folder,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(PRINTED[name], done.stdout, re.S), done.stdout
    assert len((EXAMPLES / name).read_text().splitlines()) < 40


SCRIPTS = {path.name for path in EXAMPLES.glob("*.py")}


@pytest.mark.parametrize("name", sorted((SCRIPTS | PRINTED.keys()) - {DRIVES}))
def test_an_example_runs_and_prints_its_result(name, tmp_path):
    if name == "read_bag.py":
        short = {"duration": 0.12}
        scenario = {"scenario": resolved(load_scenario("paper", short))}
        bag = tmp_path / "runs" / "latest" / "bag"
        write_record(bag, simulate("paper", short).record, custom_data=scenario)
    check(name, tmp_path)


@pytest.mark.usefixtures("domain")
def test_the_example_that_drives_a_running_hand_prints_where_it_is(tmp_path):
    options = ("--interactive", "--composed", "--out", str(tmp_path / "runs"))
    words = ("paper", *options, "--set", "targets=[]")
    with start_executable("orchestrator", *words) as hand:
        hand.wait_for_output("t = ", PATIENCE)
        check(DRIVES, tmp_path)
