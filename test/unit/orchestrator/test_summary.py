# SPDX-License-Identifier: Apache-2.0
"""A run is judged by goal, completeness, failures and signals, in an exit code with reasons."""

from __future__ import annotations

import io
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.orchestrator.results.judgement import GoalVerdict, judge, told
from tactile_hand_ros.orchestrator.results.reading import (
    Results,
    expected_ticks,
    incomplete,
    read_results,
)
from tactile_hand_ros.orchestrator.results.summary import write_summary
from tactile_hand_ros.orchestrator.results.table import table
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import load_scenario

PLAN = Plan(load_scenario("paper", {"duration": 0.1}))
STEERED = Plan(PLAN.scenario, interactive=True)
RECORDING = {
    "expected_ticks": 51,
    "ticks_per_second": 500.0,
    "messages": 900,
    "lost_messages": 0,
    "topics": {},
}


def results(**changes: Any) -> Results:
    """Return good results with some values changed."""
    good = {"final_position_error_m": 1e-5, "final_rotation_error_rad": 1e-5}
    return Results({**good, **changes}, dict(RECORDING))


def test_good_run() -> None:
    assert judge(PLAN, RunOutcome(), results(), 128) == GoalVerdict("goal reached", [], 0)


@pytest.mark.parametrize("error", [2e-4, None])
def test_missed_goal_is_said_in_numbers(error: float | None) -> None:
    verdict = judge(PLAN, RunOutcome(), results(final_position_error_m=error), 128)
    assert (verdict.outcome, verdict.exit_code) == ("goal not reached", 1)
    assert "the goal is 0.0001 m" in verdict.reasons[0]


def test_rotation_counts_too() -> None:
    verdict = judge(PLAN, RunOutcome(), results(final_rotation_error_rad=0.5), 128)
    assert verdict.reasons == ["the final rotation error is 0.5 rad, the goal is 0.001 rad"]


@pytest.mark.parametrize("plan", [PLAN, STEERED])
def test_a_dropped_object_is_called_dropped(plan: Plan) -> None:
    found, outcome = results(dropped_at_s=2.16), RunOutcome(interrupted=plan.interactive)
    verdict = judge(plan, outcome, found, 130)
    assert (verdict.outcome, verdict.exit_code) == ("object dropped", 3)
    assert verdict.reasons == ["the object was dropped at t = 2.160 s"]
    assert told(verdict, found) == "object dropped at 2.160 s"


def test_what_has_a_goal_passes_or_fails_and_no_row_contradicts_the_verdict() -> None:
    """A drop leaves nothing else to be judged; a start has no goal."""
    scenario = load_scenario("pull", {"slip_regulator.mode": "user", "duration": 2.3})
    still = load_scenario("paper", {"duration": 0.1, "targets": []})
    held = metrics(ClosedLoop(still).run(), still).to_dict()
    dropped = metrics(ClosedLoop(scenario).run(), scenario).to_dict()
    started = RunOutcome(startup={"first_tick_answered": 39.0})
    good = lines(table(PLAN, started, Results(held, dict(RECORDING))))
    assert good["final position error"][1:] == ["< 0.1 mm", "pass"]
    assert good["start to first tick"][1:] == ["", ""]
    assert "fail" not in {verdict for *_, verdict in good.values()}
    bad = lines(table(Plan(scenario), started, Results(dropped, dict(RECORDING))))
    assert bad["object"][1:] == ["held", "fail"]
    assert bad["longest slip"][1:] == ["< 1 mm", "fail"]
    assert "settling time" not in bad and "unknown" not in str(bad)


def lines(found: Table) -> dict[str, list[str]]:
    """Return the rows of a table by their first cell."""
    columns = [list(column.cells) for column in found.columns]
    return {str(name): [str(cell) for cell in rest] for name, *rest in zip(*columns, strict=True)}


def test_incomplete_bag_is_no_success() -> None:
    incomplete = results()
    incomplete.problems.append("the recorder lost 3 messages")
    verdict = judge(PLAN, RunOutcome(), incomplete, 128)
    assert (verdict.outcome, verdict.exit_code) == ("incomplete", 1)
    assert verdict.reasons == ["the recorder lost 3 messages"]


def test_failure_comes_first() -> None:
    outcome = RunOutcome(
        failure="plant ended with code 1", complaints=["recorder did not end well"]
    )
    verdict = judge(PLAN, outcome, results(), 128)
    assert verdict == GoalVerdict("failed", [outcome.failure, *outcome.complaints], 1)


@pytest.mark.parametrize("code", [130, 143])
def test_signal_gives_its_code(code: int) -> None:
    verdict = judge(PLAN, RunOutcome(interrupted=True), results(), code)
    assert (verdict.outcome, verdict.exit_code) == ("interrupted", code)


def test_ctrl_c_is_the_regular_end_of_an_interactive_run() -> None:
    outcome = RunOutcome(interrupted=True)
    assert judge(STEERED, outcome, results(), 130) == GoalVerdict("finished", [], 0)
    assert judge(STEERED, outcome, results(), 143).exit_code == 143


def test_without_a_bag_the_last_pose_that_was_seen_decides() -> None:
    seen = Results()
    assert judge(PLAN, RunOutcome(position_error=1e-5), seen, 128).exit_code == 0
    assert judge(PLAN, RunOutcome(position_error=1e-3), seen, 128).exit_code == 1
    assert judge(PLAN, RunOutcome(), seen, 128).exit_code == 1


def test_run_without_a_bag_says_so(tmp_path: Path) -> None:
    found = read_results(PLAN, RunDirectory(tmp_path), finished=True)
    assert found.metrics == {}
    assert len(found.problems) == 1


def test_run_that_was_not_to_be_recorded_has_no_problem_without_a_bag(tmp_path: Path) -> None:
    plan = Plan(PLAN.scenario, record=False)
    assert read_results(plan, RunDirectory(tmp_path), finished=True) == Results()


def test_number_of_ticks_is_known_in_lockstep_only() -> None:
    assert expected_ticks(PLAN) == 51
    realtime = load_scenario("paper", {"plant.pacing": "realtime"})
    assert expected_ticks(Plan(realtime)) is None


def test_ticks_that_nobody_answered_are_a_fault_in_lockstep_only() -> None:
    recording = dict(
        RECORDING, absent=[], topics={"/joint_command": {"ticks": 50, "complete": False}}
    )
    realtime = Plan(load_scenario("paper", {"plant.pacing": "realtime", "duration": 0.1}))
    assert incomplete(PLAN, recording, 51) == ["the bag has 50 of 51 ticks on /joint_command"]
    assert incomplete(realtime, recording, 51) == []
    good = Results(metrics(ClosedLoop(PLAN.scenario).run(), PLAN.scenario).to_dict(), recording)
    text = io.StringIO()
    Console(width=100, file=text).print(table(realtime, RunOutcome(), good))
    assert re.search(r"ticks answered .* 50 ", text.getvalue())
    assert "deadlines missed" not in text.getvalue()  # the run did not begin


def test_missed_deadlines_are_shown_with_their_causes(tmp_path: Path) -> None:
    plan = Plan(load_scenario("paper", {"plant.pacing": "realtime", "duration": 0.1}))
    plant = {
        "late_commands": "5",
        "missed_ticks": "0",
        "lost_s": "0",
        "time_s": "0.1",
        "late: preemption": "5",
        "too_slow": "this computer is too slow",
    }
    outcome = RunOutcome(last_tick=100_000_000, plant=plant)
    good = Results(metrics(ClosedLoop(PLAN.scenario).run(), PLAN.scenario).to_dict(), RECORDING)
    text = io.StringIO()
    Console(width=100, file=text).print(table(plan, outcome, good))
    assert re.search(r"deadlines missed .* 10.00 %, 5 late, 0 skipped", text.getvalue())
    assert re.search(r"missed for preemption .* 5 ", text.getvalue())
    write_summary(plan, RunDirectory(tmp_path), outcome, good, judge(plan, outcome, good, 128))
    read = json.loads((tmp_path / "summary.json").read_text())["real_time"]
    assert (read["missed_share"], read["causes"]) == (pytest.approx(0.1), {"preemption": 5})
    assert read["too_slow"] == "this computer is too slow"


def test_summary_and_table_hold_for_every_number_that_is_missing(tmp_path: Path) -> None:
    """Numbers of a real record; NaN becomes null and 'unknown'."""
    record = ClosedLoop(PLAN.scenario).run()
    record.auxiliary_position[-1] = math.nan
    full = Results(metrics(record, PLAN.scenario).to_dict(), dict(RECORDING))
    verdict = judge(PLAN, RunOutcome(), full, 128)
    write_summary(PLAN, RunDirectory(tmp_path), RunOutcome(), full, verdict)
    read = json.loads((tmp_path / "summary.json").read_text())
    assert read["metrics"]["final_position_error_m"] is None
    assert read["versions"]["tactile_hand_ros"]
    assert (read["scenario"], read["seed"], read["exit_code"]) == ("paper", 1, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
    text = io.StringIO()
    Console(width=100, file=text).print(table(PLAN, RunOutcome(), full))
    assert "final position error" in text.getvalue() and "unknown" in text.getvalue()
    assert "k_f f* = 4." in text.getvalue()
