# SPDX-License-Identifier: Apache-2.0
"""The table at the end of a run."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from tactile_hand_ros.names import JOINT_COMMAND
from tactile_hand_ros.orchestrator.results.judgement import number
from tactile_hand_ros.orchestrator.results.reading import Results, deadlines_of, is_lockstep
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.report.tables import milli, recovery_rows
from tactile_hand_ros.run.recording import Deadlines
from tactile_hand_ros.run.verdict import Judged, headline, judged
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP

Row = tuple[str, str, str, str]


def table(plan: Plan, outcome: RunOutcome, results: Results) -> Table:
    """Return the results as a table for the terminal; what has a goal passes or fails."""
    out = Table()
    out.add_column("result")
    out.add_column("value", justify="right")
    out.add_column("goal", justify="right")
    out.add_column("")
    for row in _rows(plan, outcome, results):
        out.add_row(*row)
    return out


def _rows(plan: Plan, outcome: RunOutcome, results: Results) -> list[Row]:
    m, r = results.metrics, results.recording
    held = m["dropped_at_s"] is None
    friction = [b for b in m["max_required_friction"].values() if b is not None]
    expected = str(r["expected_ticks"] or "")
    lost = r["lost_messages"]
    return [
        _plain("simulated time", f"{m['simulated_time_s']:.3f} s{_resets(results)}"),
        *([] if held else [_row("object", headline(m), "held", False)]),
        *(_held_rows(plan, results) if held else []),
        *_slip_rows(plan, m),
        _plain("required friction, peak", f"{max(friction):.3f}" if friction else "unknown"),
        _plain("peak joint rate", f"{number(m['peak_joint_rate_rad_per_s'])} rad/s"),
        _plain("ticks with a lost contact", str(m["contacts_lost_ticks"])),
        _row("ticks", str(m["ticks"]), expected, not expected or expected == str(m["ticks"])),
        *_answered(plan, r),
        *_deadline_rows(deadlines_of(plan, outcome)),
        _plain("tick rate", f"{number(r['ticks_per_second'])} ticks/s"),
        _row("messages recorded, lost", f"{r['messages']}, {lost}", "none lost", not lost),
        _plain("start to first tick", _seconds(outcome.startup.get("first_tick_answered"))),
    ]


def _resets(results: Results) -> str:
    """Say that all numbers are about what came after the last reset, where there was one."""
    return " since the last reset" if results.run is not None and results.run.earlier else ""


def _plain(name: str, value: str) -> Row:
    return name, value, "", ""


def _row(name: str, value: str, goal: str, passed: bool) -> Row:
    return name, value, goal, ("pass" if passed else "fail") if goal else ""


def _held_rows(plan: Plan, results: Results) -> list[Row]:
    """Return the rows that only an object in the hand has."""
    m = results.metrics
    recovered = recovery_rows(results.run.recoveries) if results.run is not None else []
    errors = judged(m, plan.scenario.goal)[:2]
    goals = [] if plan.interactive else errors
    total = f"{number(m['normal_force_sum_N'])} N"
    return [
        *(_limited(each, bool(goals)) for each in errors),
        *([_plain("settling time", _seconds(m["settling_time_s"]))] if goals else []),
        _plain("squeeze k_f", f"{number(m['final_grasp_force_N'])} N"),
        _plain(
            "sum of normal forces", f"{total}, {_percent(m['normal_force_sum_relative_error'])} off"
        ),
        *(
            _plain(
                f"normal force, {finger}",
                f"{number(force)} N, k_f f* = {number(m['optimal_normal_forces_N'][finger])} N",
            )
            for finger, force in m["final_normal_forces_N"].items()
        ),
        *(_plain(name, text) for name, text in recovered),
    ]


def _slip_rows(plan: Plan, m: dict[str, Any]) -> list[Row]:
    """Return the rows of slip: how far where it is known, and how often."""
    longest = [each for each in judged(m, plan.scenario.goal) if each.name == "longest slip"]
    asked = not plan.interactive and plan.scenario.goal.slip_distance < UNLIMITED_SLIP
    count = m.get("slip_count")
    times = "" if count is None else f"{count}, "
    detected = _plain("slips, detected", f"{times}{m['slip_alarm_count']}")
    return [*(_limited(each, asked) for each in longest), detected]


def _limited(each: Judged, asked: bool) -> Row:
    """Return the row of a number in thousandths of its unit, judged where a goal is asked for."""
    goal = f"< {1e3 * each.limit:g} m{each.unit}" if asked else ""
    return _row(each.name, milli(each.value, each.unit), goal, each.passed)


def _answered(plan: Plan, recording: dict[str, Any]) -> list[Row]:
    """Return a row for how many ticks have a command, which goes without saying in lockstep."""
    name = f"{plan.namespace.rstrip('/')}/{JOINT_COMMAND}"
    commands = recording["topics"].get(name)
    if is_lockstep(plan) or commands is None:
        return []
    return [_plain("ticks answered", str(commands["ticks"]))]


def _deadline_rows(deadlines: Deadlines | None) -> list[Row]:
    """Return how many deadlines were missed, and why."""
    if deadlines is None:
        return []
    counts = f"{deadlines.late:.0f} late, {deadlines.skipped:.0f} skipped"
    share = f"{100.0 * deadlines.missed_share:.2f} %"
    causes = deadlines.causes.items()
    return [
        _plain("deadlines missed", f"{share}, {counts}"),
        *(_plain(f"missed for {cause}", str(count)) for cause, count in causes),
    ]


def _seconds(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g} s"


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:{'.0f' if value >= 0.1 else '.2g'}} %"
