# SPDX-License-Identifier: Apache-2.0
"""Sweeps: from the command line to the table, and from a row back to its run."""

import csv
from pathlib import Path

import numpy as np
import pytest

from tactile_hand_ros.cli import main
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.sweep.sweep import friction_margin, make_sweep, outcome

MASS, FRICTION = "plant.object.mass=0.001..0.1:log", "plant.object.friction=0.2..1"

WORDS = ["sweep", "paper", "--over", MASS, "--over", FRICTION, "--set", "duration=0.05"]
WORDS += ["--runs", "24", "--jobs", "1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sweeps") / "sweep"
    assert main([*WORDS, "--out", str(out)]) == 0
    return out


def test_a_sweep_leaves_a_summary(folder):
    summary = (folder / "summary.md").read_text()
    assert "| missed | 24 of 24 | 100.0 % |" in summary
    assert "| max_slip_distance_m | 24 |" in summary


def test_a_row_is_its_run_again_to_the_bit(folder):
    row = list(csv.DictReader((folder / "runs.csv").read_text().splitlines()))[17]
    changes = {name: float(row[name]) for name in ("plant.object.mass", "plant.object.friction")}
    changes["seed"] = int(row["seed"])
    scenario = load_scenario("paper", {"duration": 0.05, **changes})
    record = ClosedLoop(scenario).run()
    assert float(np.nanmax(record.true_slid)) == float(row["max_slip_distance_m"])


def test_a_finished_sweep_only_shows_its_results(folder, capsys):
    before = (folder / "runs.csv").read_bytes()
    assert main([*WORDS, "--out", str(folder)]) == 0
    assert "of 24 " in capsys.readouterr().out
    assert (folder / "runs.csv").read_bytes() == before


def test_bad_input_is_refused_in_a_sentence(folder, tmp_path, capsys):
    def sweep(*words: str) -> str:
        assert main(["sweep", f"--out={tmp_path / 'x'}", "--jobs=1", *words]) == 2
        text = capsys.readouterr().err
        assert text.startswith(("tactile-hand: ", "Usage: ")) and "Traceback" not in text
        return text

    assert "did you mean 'mass'" in sweep("paper", "--over=plant.object.mas=1..2")
    assert "expected the lower bound first" in sweep("paper", "--over=plant.object.mass=2..1")
    assert "should be greater than 0" in sweep("paper", "--over=plant.object.mass=-1..1")
    assert "should be greater than 0" in sweep("paper", "--over=plant.object.mass=1,0,2")
    assert "should be less than or equal to 92" in sweep("paper", "--set", f"seed={2**63}")
    assert "nothing is varied" in sweep("paper")
    for more in ("--over=plant.object.mass=1,2", "--set=plant.object.mass=1"):
        assert "plant.object.mass is given twice" in sweep("paper", f"--over={MASS}", more)
    assert "did you mean 'paper'" in sweep("papr", f"--over={MASS}")
    assert "expected 1 or more processes" in sweep("paper", f"--over={MASS}", "--jobs=0")
    assert "another study: runs is 24 there" in sweep("paper", f"--over={MASS}", f"--out={folder}")
    assert not (tmp_path / "x" / "study.json").exists()


def test_paths_lead_into_lists_and_whole_numbers_stay_whole():
    seeds = make_sweep("gravity", ["seed=1..5"], {})
    assert [seeds.point(i).values["seed"] for i in range(len(seeds.fractions))] == [1, 2, 3, 4, 5]
    made = make_sweep("gravity", ["gravity.2=-9.81..-1", "seed=1..5"], {}, runs=10)
    points = [made.point(index) for index in range(10)]
    assert sorted(point.values["seed"] for point in points) == sorted([1, 2, 3, 4, 5] * 2)
    scenario = made.run.scenario_of(points[0])
    assert scenario.gravity == (0.0, 0.0, points[0].values["gravity.2"])
    assert scenario.seed == points[0].values["seed"] == scenario.tactile_sensor.seed
    with pytest.raises(ConfigurationError, match="'gravity' has no '3' in it"):
        make_sweep("gravity", ["gravity.3=0..1"], {})


def test_a_seed_that_is_set_is_that_of_all_runs():
    made = make_sweep("gravity", ["plant.object.mass=0.1..0.3"], {"seed": 3}, runs=4)
    points = [made.point(index) for index in range(4)]
    scenarios = [made.run.scenario_of(point) for point in points]
    assert [(each.seed, each.tactile_sensor.seed) for each in scenarios] == [(3, 3)] * 4
    assert len({each.plant.object.mass for each in scenarios}) == 4


def test_the_margin_is_what_the_true_friction_leaves():
    scenario = load_scenario("gravity", {"duration": 0.1, "targets": []})
    record = ClosedLoop(scenario).run()
    found = metrics(record, scenario)
    worst = np.inf
    for tick in np.flatnonzero(record.times >= 0.02):
        for x, y, z in record.true_forces[tick]:
            worst = min(worst, 1.0 - np.hypot(x, z) / y / scenario.plant.object.friction)
    assert friction_margin(record, scenario) == pytest.approx(worst, abs=1e-12)
    assert outcome(record, found) in ("reached", "missed")
    record.true_positions[-1, 0] = np.nan
    assert outcome(record, found) == "lost"


def test_the_friction_is_another_one_only_after_the_tick_of_its_change():
    change = {"start": 0.3, "friction": 0.2}
    scenario = load_scenario(
        "gravity", {"plant.object.friction": 0.8, "plant.friction_changes": [change]}
    )
    record = Record.empty(3, ["a", "b"], ["j"])
    record.stamps[:] = 200_000_000, 300_000_000, 400_000_000
    record.true_positions[:], record.true_forces[:] = 0.0, (0.0, 1.0, 0.0)
    record.true_forces[1, 1, 0], record.true_forces[2, 0, 2] = 0.4, 0.12
    assert record.times[1] > 0.3  # as doubles
    assert friction_margin(record, scenario) == pytest.approx(1.0 - 0.12 / 0.2)


def test_a_sweep_is_not_continued_with_another_law(tmp_path, capsys):
    """Under the same name: its results would be mixed with those of the law before."""
    law = tmp_path / "weak_law.py"
    law.write_text("from tactile_hand_ros.control.laws import OptimalLaw as Weak\n")
    (tmp_path / "mine.yaml").write_text("extends: paper\nduration: 0.02\nlaw: weak_law:Weak\n")
    words = ["sweep", str(tmp_path / "mine.yaml"), "--over", MASS, "--runs", "2", "--jobs", "1"]
    words += ["--out", str(tmp_path / "out")]
    assert main(words) == main(words) == 0
    law.write_text("from tactile_hand_ros.control.laws import KawamuraLaw as Weak\n")
    assert main(words) == 2
    assert f"content of {law.resolve()} is" in capsys.readouterr().err
