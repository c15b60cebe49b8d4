# SPDX-License-Identifier: Apache-2.0
"""The table at the end of a run, row by row; the sentences of a bag that is not whole."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Any

import pytest

from tactile_hand_ros.orchestrator.results.judgement import judge
from tactile_hand_ros.orchestrator.results.reading import Results, deadlines_of, incomplete
from tactile_hand_ros.orchestrator.results.report import open_report
from tactile_hand_ros.orchestrator.results.table import table
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.scenario.scenario import load_scenario

GOAL = {"goal.position_error": 2e-4, "goal.rotation_error": 3e-3, "goal.slip_distance": 4e-3}
PLAN = Plan(load_scenario("paper", {"duration": 0.1, **GOAL}))
STEERED = Plan(PLAN.scenario, interactive=True)
REAL_TIME = Plan(
    load_scenario("paper", {"duration": 0.1, "plant.pacing": "realtime", **GOAL}), "/left"
)
METRICS: dict[str, Any] = {
    "simulated_time_s": 0.1,
    "dropped_at_s": None,
    "ticks": 51,
    "final_position_error_m": 1e-4,
    "final_rotation_error_rad": 2e-3,
    "max_slip_distance_m": 5e-3,
    "slip_count": 3,
    "slip_alarm_count": 4,
    "max_required_friction": {"a": 0.25, "b": None, "c": 0.5},
    "peak_joint_rate_rad_per_s": 1.25,
    "contacts_lost_ticks": 6,
    "normal_force_sum_N": 12.5,
    "normal_force_sum_relative_error": 0.0123,
    "final_grasp_force_N": 11.5,
    "settling_time_s": 0.0625,
    "final_normal_forces_N": {"a": 4.5, "b": 5.5},
    "optimal_normal_forces_N": {"a": 4.25, "b": None},
}
RECORDING: dict[str, Any] = {
    "expected_ticks": 51,
    "ticks_per_second": 498.75,
    "messages": 900,
    "lost_messages": 0,
    "absent": [],
    "topics": {},
}
STARTED = RunOutcome(startup={"first_tick_answered": 1.23456}, last_tick=100_000_000)


def rows(plan: Plan, metrics: dict[str, Any], recording: dict[str, Any]) -> list[list[str]]:
    """Return the table's rows: name, value, goal, verdict."""
    found = table(plan, STARTED, Results({**METRICS, **metrics}, {**RECORDING, **recording}))
    columns = [list(column.cells) for column in found.columns]
    return [[str(cell) for cell in row] for row in zip(*columns, strict=True)]


def cells(*changed: Any, **recording: Any) -> dict[str, list[str]]:
    plan, metrics = changed
    return {name: rest for name, *rest in rows(plan, metrics, recording)}


def test_all_rows_of_a_run_that_held_its_object() -> None:
    assert rows(PLAN, {}, {}) == [
        ["simulated time", "0.100 s", "", ""],
        ["final position error", "0.1 mm", "< 0.2 mm", "pass"],
        ["final rotation error", "2 mrad", "< 3 mrad", "pass"],
        ["settling time", "0.0625 s", "", ""],
        ["squeeze k_f", "11.5 N", "", ""],
        ["sum of normal forces", "12.5 N, 1.2 % off", "", ""],
        ["normal force, a", "4.5 N, k_f f* = 4.25 N", "", ""],
        ["normal force, b", "5.5 N, k_f f* = unknown N", "", ""],
        ["longest slip", "5 mm", "< 4 mm", "fail"],
        ["slips, detected", "3, 4", "", ""],
        ["required friction, peak", "0.500", "", ""],
        ["peak joint rate", "1.25 rad/s", "", ""],
        ["ticks with a lost contact", "6", "", ""],
        ["ticks", "51", "51", "pass"],
        ["tick rate", "498.8 ticks/s", "", ""],
        ["messages recorded, lost", "900, 0", "none lost", "pass"],
        ["start to first tick", "1.235 s", "", ""],
    ]


def test_a_steered_run_has_no_goal() -> None:
    found = cells(STEERED, {}, expected_ticks=None)
    assert found["final position error"] == ["0.1 mm", "", ""]
    assert found["longest slip"] == ["5 mm", "", ""]
    assert found["ticks"] == ["51", "", ""]
    assert "settling time" not in found


@pytest.mark.parametrize(
    ("metrics", "recording", "row"),
    [
        ({"ticks": 50}, {}, ["ticks", "50", "51", "fail"]),
        ({}, {"lost_messages": 2}, ["messages recorded, lost", "900, 2", "none lost", "fail"]),
        ({"slip_count": None}, {}, ["slips, detected", "4", "", ""]),
        ({"slip_count": 0}, {}, ["slips, detected", "0, 4", "", ""]),
        (
            {"max_required_friction": {"a": None}},
            {},
            ["required friction, peak", "unknown", "", ""],
        ),
        ({"settling_time_s": None}, {}, ["settling time", "unknown", "", ""]),
        (
            {"normal_force_sum_relative_error": 0.1},
            {},
            ["sum of normal forces", "12.5 N, 10 % off", "", ""],
        ),
        (
            {"normal_force_sum_relative_error": 0.0999},
            {},
            ["sum of normal forces", "12.5 N, 10 % off", "", ""],
        ),
        (
            {"normal_force_sum_relative_error": 0.256},
            {},
            ["sum of normal forces", "12.5 N, 26 % off", "", ""],
        ),
        (
            {"normal_force_sum_relative_error": None},
            {},
            ["sum of normal forces", "12.5 N, unknown off", "", ""],
        ),
    ],
)
def test_a_number_in_its_row(
    metrics: dict[str, Any], recording: dict[str, Any], row: list[str]
) -> None:
    assert row in rows(PLAN, metrics, recording)


def test_a_dropped_object_has_no_pose_and_no_forces() -> None:
    found = cells(PLAN, {"dropped_at_s": 0.05})
    assert found["object"] == ["object dropped at 0.050 s", "held", "fail"]
    assert not {"final position error", "squeeze k_f", "settling time"} & set(found)


def test_in_real_time_answers_and_deadlines_are_told() -> None:
    topics = {"/left/joint_command": {"ticks": 49, "complete": False}}
    assert cells(REAL_TIME, {}, topics=topics)["ticks answered"] == ["49", "", ""]
    assert "ticks answered" not in cells(REAL_TIME, {})
    assert "ticks answered" not in cells(PLAN, {}, topics=topics)
    assert "deadlines missed" not in cells(PLAN, {})


def test_deadlines_are_those_of_the_time_that_was_asked_for_or_of_the_user() -> None:
    """Of a run that stood still before its end, what never came was missed."""
    plant = {"late_commands": "1", "missed_ticks": "2", "lost_s": "0", "time_s": "0.05"}
    outcome = RunOutcome(last_tick=50_000_000, plant=plant)
    asked = deadlines_of(REAL_TIME, outcome)
    assert asked is not None and (asked.due, asked.given_up) == (50.0, 25.0)
    steered = deadlines_of(Plan(REAL_TIME.scenario, interactive=True), outcome)
    assert steered is not None and (steered.due, steered.given_up) == (25.0, 0.0)
    begun = RunOutcome(last_tick=0, plant=plant)
    assert deadlines_of(REAL_TIME, begun) is not None
    assert deadlines_of(REAL_TIME, RunOutcome(last_tick=-1, plant=plant)) is None
    assert deadlines_of(PLAN, outcome) is None


def test_topics_that_lack_the_same_share_a_sentence() -> None:
    recording = {
        "absent": ["/x", "/y"],
        "topics": {
            "/a": {"ticks": 40, "complete": False},
            "/b": {"ticks": 51, "complete": True},
            "/c": {"ticks": 30, "complete": False},
            "/d": {"ticks": 40, "complete": False},
            "/e": {"ticks": 20, "complete": None},
        },
    }
    sentences = [
        "the bag has nothing on /x, /y",
        "the bag has 30 of 51 ticks on /c",
        "the bag has 40 of 51 ticks on /a, /d",
    ]
    assert incomplete(PLAN, recording, 51) == sentences
    assert incomplete(REAL_TIME, recording, 51) == sentences[:1]


def test_an_interrupt_before_the_first_tick_leaves_nothing_to_miss() -> None:
    trouble = Results(problems=["no bag"])
    stopped = RunOutcome(interrupted=True, complaints=["plant did not end well"])
    assert judge(PLAN, stopped, trouble, 130).reasons == ["plant did not end well"]
    begun = Results(METRICS, RECORDING, ["no bag"])
    assert judge(PLAN, stopped, begun, 130).reasons == ["no bag", "plant did not end well"]
    assert judge(STEERED, stopped, begun, 130).exit_code == 1


@pytest.mark.parametrize(
    ("exists", "opens", "begins"),
    [
        (False, True, "there is no report to open"),
        (True, True, "opened file:///"),
        (True, False, "no browser was found here; open file:///"),
    ],
)
def test_a_report_is_opened_where_there_is_one(
    exists: bool, opens: bool, begins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda _: opens)
    if exists:
        (tmp_path / "report.html").touch()
    assert open_report(RunDirectory(tmp_path)).startswith(begins)


def test_a_table_has_four_columns_of_which_numbers_stand_to_the_right() -> None:
    found = table(PLAN, STARTED, Results(METRICS, RECORDING))
    assert [str(column.header) for column in found.columns] == ["result", "value", "goal", ""]
    assert [column.justify for column in found.columns] == ["left", "right", "right", "left"]
