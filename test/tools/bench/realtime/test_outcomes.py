# SPDX-License-Identifier: Apache-2.0
"""Scenario runs are planned in turn, kept as they end, continued, and summed up by case."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.realtime.outcomes import (
    COLUMNS,
    Outcome,
    ScenarioCase,
    append,
    calls_line,
    outcome_of,
    read,
    rows,
    run_case,
    scenario_cases,
)
from bench.realtime.schedule import planned, run_planned
from bench.runs import GraphRun, is_dropped
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.run.recording import read_deadlines
from tactile_hand_ros.scenario.scenario import load_scenario

CASE = ScenarioCase("pull", "realtime", 500.0, True, 8.0)
GOOD = Outcome(CASE, 0, True, False, 0.125, 51.0, 0.01, 0.0, 5000.0)
BAD = replace(GOOD, run=1, goal=False, dropped=True, slip_mm=90.0, calls=3000.0)


def test_a_scenario_is_run_at_its_own_rate_and_at_half_of_it() -> None:
    lockstep, own, half, processes = scenario_cases(["gravity"], priority=50)
    assert [c.rate for c in (lockstep, own, half, processes)] == [1000.0, 1000.0, 500.0, 500.0]
    assert [c.composed for c in (own, half, processes)] == [True, True, False]
    assert (lockstep.priority, own.priority) == (0, 50)
    assert "--priority" in own.options and "--processes" in processes.options
    chosen = scenario_cases(["gravity"], [250.0, 500.0], duration=2.0)
    assert [(c.pacing, c.rate) for c in chosen[1:]] == [
        ("realtime", rate) for rate in (250.0, 250.0, 500.0, 500.0)
    ]
    assert {c.duration for c in chosen} == {2.0}


def test_every_case_has_its_turn_before_a_round_begins_and_lockstep_runs_once() -> None:
    lockstep = replace(CASE, pacing="lockstep")
    assert planned([lockstep, CASE], 2) == [(lockstep, 0), (CASE, 0), (CASE, 1)]


def test_outcomes_that_are_kept_are_not_run_again(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    append(GOOD, file)
    append(BAD, file)
    with file.open("a") as lines:
        lines.write('{"case": {"sce')  # killed while it wrote
    assert read(file) == [GOOD, BAD]
    said: list[str] = []
    found = list(run_planned(planned([CASE], 3), file, limit=0.0, progress=said.append))
    assert found == [GOOD, BAD]  # no time is left for the third
    assert said == [str(CASE)] * 2
    assert read(tmp_path / "none") == []


def test_cases_are_summed_up_by_median_and_worst() -> None:
    (row,) = rows([GOOD, BAD])
    assert len(row) == len(COLUMNS)
    assert row[:6] == ["pull", "realtime", "500", "composed", "1/2", "1"]
    assert row[6:8] == ["45.06 (90.00)", "51 (51)"]
    assert "4000 ticks/s" in calls_line([GOOD, BAD]) and "3000 to 5000" in calls_line([GOOD, BAD])


def test_a_run_that_is_refused_is_an_outcome_with_its_reason() -> None:
    outcome = run_case(replace(CASE, rate=3.0, duration=0.1), 0, 5000.0)
    assert not outcome.goal and math.isnan(outcome.slip_mm)
    assert "plant" in outcome.problem and outcome.problem in str(outcome)
    assert rows([outcome])[0][6] == "unknown"


@pytest.mark.parametrize("pacing", ["lockstep", "realtime"])
def test_an_outcome_is_read_from_summary_and_plant(pacing: str) -> None:
    facts = {"late_commands": "40", "missed_ticks": "20", "lost_s": "0", "time_s": "8"}
    summary = {
        "metrics": {"max_slip_distance_m": 0.002},
        "outcome": "goal reached",
        "real_time": read_deadlines(facts, 500.0, 8.0, 8.0).to_dict(),
    }
    graph = GraphRun(summary, facts, [], peak_grasp_force=51.0)
    outcome = outcome_of(replace(CASE, pacing=pacing), 2, 5000.0, graph)
    assert (outcome.goal, outcome.slip_mm, outcome.peak_force) == (True, 2.0, 51.0)
    expected = (0.01, 0.005) if pacing == "realtime" else (0.0, 0.0)
    assert (outcome.late, outcome.skipped) == pytest.approx(expected)


def test_an_object_is_dropped_when_fewer_than_two_fingers_touch_at_the_end() -> None:
    record = ClosedLoop(load_scenario("paper")).run(5)
    assert not is_dropped(record)
    record.contact_positions[-1, 1:] = np.nan
    assert is_dropped(record)
    record.forces[-1] = np.nan
    record.contact_positions[-1] = np.nan
    assert not is_dropped(record)  # of the last tick nothing is known
