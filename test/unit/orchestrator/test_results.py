# SPDX-License-Identifier: Apache-2.0
"""A run is judged by goal, completeness, failures and signals, with exit code and reasons."""

import copy
import io
import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from support.recorded import random_record, write_record

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.orchestrator.monitor import line_console
from tactile_hand_ros.orchestrator.results import (
    RunResults,
    RunVerdict,
    in_words,
    judge,
    read_results,
    real_time_counts,
    report_line,
    table,
    write_summary,
)
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario

TICKS = 51
PLAN = Plan(load_scenario("paper", {"duration": 0.1, "targets": []}))
STEERED = Plan(PLAN.scenario, interactive=True)
REAL_TIME = Plan(load_scenario("paper", {"plant.pacing": "realtime", "duration": 0.1}))
DONE = RunOutcome()
GOOD = replace(
    metrics(Record.empty(1, ["a"], ["j"])),
    final_position_error_m=1e-5,
    final_rotation_error_rad=1e-5,
)


@cache
def recorded() -> Record:
    """Return the record of the plan's run."""
    return ClosedLoop(PLAN.scenario).run()


@pytest.fixture
def directory(tmp_path: Path) -> RunDirectory:
    """Return the directory of a recorded run of the plan."""
    made = RunDirectory(tmp_path)
    write_record(made.bag, recorded())
    made.write_scenario(PLAN.scenario)
    return made


def results(*problems: str, **changes: Any) -> RunResults:
    """Return good results with some values changed."""
    return RunResults(metrics=replace(GOOD, **changes), problems=list(problems))


FAR, LOST = results(final_position_error_m=2e-4), results(final_rotation_error_rad=math.nan)


@pytest.mark.parametrize(
    ("found", "outcome", "reasons"),
    [
        (results(), "goal reached", []),
        (FAR, "goal not reached", ["the final position error is 0.0002 m, the goal is 0.0001 m"]),
        (LOST, "goal not reached", ["the final rotation error is unknown, the goal is 0.001 rad"]),
        (results("3 messages lost"), "incomplete", ["3 messages lost"]),
    ],
)
def test_a_run_is_judged_by_its_goal_and_its_bag(found, outcome, reasons):
    expected = RunVerdict(outcome, reasons, len(reasons))
    assert judge(PLAN, RunOutcome(), found, 128) == expected
    assert in_words(expected, found) == outcome


@pytest.mark.parametrize("plan", [PLAN, STEERED])
def test_a_dropped_object_is_called_dropped(plan):
    found, outcome = results(dropped_at_s=2.16), RunOutcome(interrupted=plan.interactive)
    verdict = judge(plan, outcome, found, 130)
    assert (verdict.outcome, verdict.exit_code) == ("object dropped", 3)
    assert verdict.reasons == ["the object was dropped at t = 2.160 s"]
    assert in_words(verdict, found) == "object dropped at 2.160 s"


def test_a_failure_comes_first():
    outcome = RunOutcome(failure="plant ended", complaints=["recorder did not stop cleanly"])
    verdict = judge(PLAN, outcome, results("no bag"), 128)
    assert verdict == RunVerdict("failed", [outcome.failure, "no bag", *outcome.complaints], 1)


@pytest.mark.parametrize(
    ("plan", "code", "outcome", "exit_code"),
    [
        (PLAN, 130, "interrupted", 130),
        (PLAN, 143, "interrupted", 143),
        (STEERED, 130, "finished", 0),
        (STEERED, 143, "interrupted", 143),
    ],
)
def test_ctrl_c_is_the_regular_end_of_an_interactive_run_alone(plan, code, outcome, exit_code):
    verdict = judge(plan, RunOutcome(interrupted=True), results(), code)
    assert verdict == RunVerdict(outcome, [], exit_code)


def test_an_interrupt_before_the_first_tick_leaves_nothing_to_miss():
    stopped = RunOutcome(interrupted=True, complaints=["plant did not stop cleanly"])
    nothing = RunResults(problems=["no bag"])
    assert judge(PLAN, stopped, nothing, 130).reasons == ["plant did not stop cleanly"]
    started = results("no bag")
    assert judge(PLAN, stopped, started, 130).reasons == ["no bag", "plant did not stop cleanly"]
    assert judge(STEERED, stopped, started, 130).exit_code == 1


def test_without_a_bag_a_run_is_not_judged_and_a_bag_that_should_be_there_is_missed(tmp_path):
    plan = Plan(PLAN.scenario, record=False)
    found = read_results(plan, RunDirectory(tmp_path), DONE)
    assert judge(plan, RunOutcome(), found, 128) == RunVerdict("finished", [], 0)
    lost = read_results(PLAN, RunDirectory(tmp_path), DONE)
    verdict = judge(PLAN, RunOutcome(), lost, 128)
    assert (verdict.outcome, verdict.exit_code, len(verdict.reasons)) == ("incomplete", 1, 1)


def test_a_bag_that_is_short_is_a_problem_of_a_finished_run_in_lockstep(directory):
    longer = load_scenario("paper", {"duration": 0.102, "targets": []})
    found = read_results(PLAN, directory, DONE)
    assert found.run is not None and found.problems == []
    assert found.recording["expected_ticks"] == found.run.metrics.ticks == TICKS
    short = f"the bag holds {TICKS} ticks, expected {TICKS + 1}"
    assert short in read_results(Plan(longer), directory, DONE).problems
    assert short not in read_results(Plan(longer), directory, RunOutcome(interrupted=True)).problems
    late = Plan(longer.changed({"plant.pacing": "realtime"}))
    found = read_results(late, directory, DONE)
    assert found.recording["expected_ticks"] is None and found.problems == []


def test_lost_messages_are_those_of_the_hand(tmp_path):
    """The recorder may miss a node's messages from before its discovery."""
    lost = {"": "45", "/parameter_events": "43", "/left/joint_states": "2"}
    directory = RunDirectory(tmp_path)
    noted = {f"lost_messages{topic}": count for topic, count in lost.items()}
    write_record(directory.bag, recorded(), custom_data=noted)
    found = read_results(PLAN, directory, DONE)
    assert found.recording["lost_messages"] == 2
    assert found.problems == ["the recorder lost 2 messages"]


def shown(plan: Plan, outcome: RunOutcome, found: RunResults) -> dict[str, list[str]]:
    """Return the rows of the table by their first cell."""
    columns = [list(column.cells) for column in table(plan, outcome, found).columns]
    return {str(name): [str(cell) for cell in rest] for name, *rest in zip(*columns, strict=True)}


def test_what_has_a_goal_passes_or_fails(directory):
    started = RunOutcome(first_tick=2.5)
    found = read_results(PLAN, directory, DONE)
    rows = shown(PLAN, started, found)
    assert rows["final position error"][1:] == ["< 0.1 mm", "pass"]
    assert rows["longest slip"][1:] == ["", ""]  # the scenario does not limit it
    assert rows["lost messages"] == ["0", "none", "pass"]
    assert rows["start to first tick"] == ["2.5 s", "", ""]
    assert "deadlines missed" not in rows and "goal" not in rows
    steered = shown(STEERED, started, found)
    assert steered["final position error"][1:] == ["", ""]
    text = io.StringIO()
    line_console(text, width=80).print(table(PLAN, started, found))
    assert "…" not in text.getvalue()  # nothing is cut off at 80 columns


def test_a_drop_leaves_nothing_else_to_be_judged(tmp_path):
    record, directory = random_record(), RunDirectory(tmp_path)
    record.contact_positions[10:, 1:], record.forces[10:, 1:] = math.nan, 0.0
    record.true_positions[10:, 1:] = math.nan
    write_record(directory.bag, record)
    found = read_results(PLAN, directory, DONE)
    rows = shown(PLAN, DONE, found)
    assert rows["object"][0].startswith("dropped at")
    assert not {"final position error", "settling time"} & set(rows)
    assert judge(PLAN, DONE, found, 128).exit_code == 3


def test_deadlines_are_those_of_the_wall_clock(directory):
    """The ticks during which the machine stalled count as skipped."""
    plant = {"late_commands": "1", "missed_ticks": "2", "lost_s": "0.01", "time_s": "0.05"}
    outcome = RunOutcome(last_tick=50_000_000, plant=plant)
    kept = real_time_counts(REAL_TIME, outcome)
    assert kept is not None and kept["missed_fraction"] == pytest.approx(8 / 30)
    assert real_time_counts(REAL_TIME, RunOutcome(last_tick=-1, plant=plant)) is None
    assert real_time_counts(PLAN, outcome) is None
    found = read_results(REAL_TIME, directory, DONE)
    counts = shown(REAL_TIME, outcome, found)["deadlines missed"][0]
    assert counts.endswith("%, 1 late, 7 skipped")
    verdict = judge(REAL_TIME, outcome, found, 128)
    write_summary(REAL_TIME, directory, outcome, found, verdict)
    assert json.loads(directory.summary.read_text())["real_time"]["late"] == 1.0


def test_a_summary_holds_for_every_number_that_is_missing(tmp_path):
    record = copy.deepcopy(recorded())
    record.auxiliary_position[-1] = math.nan
    directory = RunDirectory(tmp_path)
    write_record(directory.bag, record)
    directory.write_scenario(PLAN.scenario)
    found = read_results(PLAN, directory, DONE)
    write_summary(PLAN, directory, RunOutcome(), found, judge(PLAN, RunOutcome(), found, 128))
    read = json.loads(directory.summary.read_text())
    assert read["metrics"]["final_position_error_m"] is None
    assert read["versions"]["tactile_hand_ros"] and read["assumptions"]
    assert (read["scenario"], read["seed"], read["exit_code"]) == ("paper", 1, 1)
    assert shown(PLAN, RunOutcome(), found)["final position error"][0] == "unknown"


def test_a_report_that_fails_does_not_cost_the_run(tmp_path):
    write_record(tmp_path / "bag", random_record(5))
    assert report_line(Run(tmp_path)) == f"report: {tmp_path / 'report.html'}"
    (tmp_path / "report.html").unlink()
    (tmp_path / "report.html").mkdir()
    line = report_line(Run(tmp_path))
    assert line.startswith("the report was not written: ") and "\n" not in line
