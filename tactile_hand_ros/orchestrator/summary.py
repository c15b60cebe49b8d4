# SPDX-License-Identifier: Apache-2.0
"""The results of a run, computed from its bag, as JSON and as a table."""

from __future__ import annotations

import datetime
import json
import math
import webbrowser
from dataclasses import dataclass, field
from typing import Any

from rich.table import Table

from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.closed_loop.scenario import UNLIMITED_SLIP
from tactile_hand_ros.errors import TactileHandError, counted
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.names import JOINT_COMMAND
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.report.page import REPORT, write_report
from tactile_hand_ros.report.tables import milli, recovery_rows
from tactile_hand_ros.run.deadlines import Deadlines, read_deadlines
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.run.verdict import (
    DROPPED,
    NOT_REACHED,
    REACHED,
    STEERED,
    Judged,
    headline,
    judged,
)

LOST_KEY = "lost_messages"
EXIT_DROPPED = 3
INCOMPLETE = "incomplete"


@dataclass
class Results:
    """What the bag says.

    Attributes:
        metrics: `Run.metrics` as plain data, empty without a bag or a tick.
        recording: Message counts against ticks, empty without a bag or a tick.
        problems: A sentence for each thing that is wrong with the bag.
        assumptions: `Run.ledger` as plain data.
        recoveries: `Run.recoveries` as plain data.
        run: The run as it was read, None without a bag or a tick.
    """

    metrics: dict[str, Any] = field(default_factory=dict)
    recording: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    assumptions: list[dict[str, Any]] = field(default_factory=list)
    recoveries: list[dict[str, Any]] = field(default_factory=list)
    run: Run | None = None


def read_results(plan: Plan, directory: RunDirectory, *, finished: bool) -> Results:
    """Compute the results from the bag.

    Args:
        plan: What was to be run.
        directory: The run.
        finished: Whether all ticks must be there.
    """
    results = Results()
    if not plan.record:
        return results
    try:
        run = Run(directory.path, namespace=plan.namespace, steered=plan.interactive)
        results.metrics = run.metrics.to_dict()
        results.recording = run.bag_metrics.to_dict()
        results.assumptions = [line.to_dict() for line in run.ledger]
        results.recoveries = [each.to_dict() for each in run.recoveries]
        results.run = run
    except TactileHandError as error:
        results.problems.append(str(error))
        return results
    expected = expected_ticks(plan) if finished else None
    results.recording["expected_ticks"] = expected
    lost = int(run.summary.custom_data.get(LOST_KEY, "0"))
    results.recording["lost_messages"] = lost
    results.problems += incomplete(plan, results.recording, results.metrics["ticks"])
    if expected not in (None, results.metrics["ticks"]):
        results.problems.append(
            f"the bag holds {results.metrics['ticks']} ticks, expected {expected}"
        )
    if lost:
        results.problems.append(f"the recorder lost {counted(lost, 'message')}")
    return results


def expected_ticks(plan: Plan) -> int | None:
    """Return how many ticks a finished run has; None in real time, where late ones are skipped."""
    return plan.scenario.ticks if _is_lockstep(plan) else None


def _is_lockstep(plan: Plan) -> bool:
    return plan.scenario.plant.pacing == "lockstep"


def incomplete(plan: Plan, recording: dict[str, Any], ticks: int) -> list[str]:
    """Say which topics lack messages, in one sentence for all that lack the same.

    In real time late nodes skip ticks, which is no fault of the recording.
    """
    found: list[str] = []
    if recording["absent"]:
        found.append(f"the bag has nothing on {', '.join(recording['absent'])}")
    short = {
        topic: c["ticks"]
        for topic, c in recording["topics"].items()
        if c["complete"] is False and _is_lockstep(plan)
    }
    for count in sorted(set(short.values())):
        topics = ", ".join(topic for topic, present in short.items() if present == count)
        found.append(f"the bag has {count} of {ticks} ticks on {topics}")
    return found


@dataclass(frozen=True)
class GoalVerdict:
    """How a run is judged.

    Attributes:
        outcome: ``goal reached``, ``goal not reached``, ``object dropped``, ``incomplete`` (the
            goal was reached, but something is missing), ``finished`` (a user ended it),
            ``interrupted``, ``failed``.
        reasons: Sentences that say why it is not simply good.
        exit_code: Of the orchestrator.
    """

    outcome: str
    reasons: list[str]
    exit_code: int


def judge(plan: Plan, outcome: RunOutcome, results: Results, signal_code: int) -> GoalVerdict:
    """Judge a run.

    Args:
        plan: What was to be run.
        outcome: What the orchestrator saw.
        results: What the bag says.
        signal_code: Exit code if a signal ended it.
    """
    # A run that was interrupted before its first tick lacks nothing that it should have.
    expected = results.metrics or not outcome.interrupted
    troubles = [*(results.problems if expected else []), *outcome.complaints]
    if outcome.failure:
        return GoalVerdict("failed", [outcome.failure, *troubles], 1)
    ended = outcome.interrupted and plan.interactive and signal_code == _CTRL_C
    if outcome.interrupted and not ended:
        return GoalVerdict("interrupted", troubles, signal_code)
    dropped = results.metrics.get("dropped_at_s")
    if dropped is not None:
        reason = f"the object was dropped at t = {dropped:.3f} s"
        return GoalVerdict(DROPPED, [reason, *troubles], EXIT_DROPPED)
    if ended:
        return GoalVerdict(STEERED, troubles, 1 if troubles else 0)
    missed = _missed(plan, outcome, results)
    if missed:
        return GoalVerdict(NOT_REACHED, [*missed, *troubles], 1)
    return GoalVerdict(INCOMPLETE, troubles, 1) if troubles else GoalVerdict(REACHED, [], 0)


_CTRL_C = 130


def _missed(plan: Plan, outcome: RunOutcome, results: Results) -> list[str]:
    """Say by how much the goal was missed; without a bag, by the last pose that was seen."""
    goal = plan.scenario.goal
    if results.metrics:
        checks = judged(results.metrics, goal)
    else:
        seen = None if math.isnan(outcome.position_error) else outcome.position_error
        checks = [Judged("final position error", seen, goal.position_error, "m")]
    return [
        f"the {each.name} is {_number(each.value)} {each.unit}, the goal is {each.limit:g} "
        f"{each.unit}"
        for each in checks
        if not each.passed
    ]


def write_summary(
    plan: Plan, directory: RunDirectory, outcome: RunOutcome, results: Results, verdict: GoalVerdict
) -> None:
    """Write ``summary.json`` whole or not at all."""
    scenario, deadlines = plan.scenario, deadlines_of(plan, outcome)
    content = {
        "scenario": scenario.name,
        "outcome": verdict.outcome,
        "exit_code": verdict.exit_code,
        "reasons": verdict.reasons,
        "goal": {
            "position_error_m": scenario.goal.position_error,
            "rotation_error_rad": scenario.goal.rotation_error,
            "slip_distance_m": scenario.goal.slip_distance,
        },
        "metrics": results.metrics,
        "assumptions": results.assumptions,
        "recoveries": results.recoveries,
        "recording": results.recording,
        "real_time": None if deadlines is None else deadlines.to_dict(),
        "startup_s": outcome.startup,
        "seed": scenario.seed,
        "pacing": scenario.plant.pacing,
        "namespace": plan.namespace,
        "interactive": plan.interactive,
        "finished_at": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "versions": versions(),
    }
    text = json.dumps(json_ready(content), indent=2, allow_nan=False)
    replace_text(directory.summary, text + "\n")


def report_line(results: Results) -> str:
    """Write the report and return a line that says where it is, empty where nothing was recorded.

    A page that fails must not cost the run: whatever goes wrong is said and nothing else happens.
    """
    if results.run is None:
        return ""
    try:
        return f"report: {write_report(results.run)}"
    except Exception as error:
        return f"the report was not written: {error or type(error).__name__}"


def open_report(directory: RunDirectory) -> str:
    """Open the report in a browser and return a line that says so, or what to do instead."""
    file = (directory.path / REPORT).resolve()
    if not file.is_file():
        return "there is no report to open"
    if webbrowser.open(file.as_uri()):
        return f"opened {file.as_uri()}"
    return f"no browser was found here; open {file.as_uri()} in one"


def told(verdict: GoalVerdict, results: Results) -> str:
    """Return what became of a run in a few words, with the time where the object was dropped."""
    if verdict.outcome == DROPPED:
        return headline(results.metrics)
    return verdict.outcome


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


Row = tuple[str, str, str, str]


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
        _plain("peak joint rate", f"{_number(m['peak_joint_rate_rad_per_s'])} rad/s"),
        _plain("ticks with a lost contact", str(m["contacts_lost_ticks"])),
        _row("ticks", str(m["ticks"]), expected, not expected or expected == str(m["ticks"])),
        *_answered(plan, r),
        *_deadline_rows(deadlines_of(plan, outcome)),
        _plain("tick rate", f"{_number(r['ticks_per_second'])} ticks/s"),
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
    total = f"{_number(m['normal_force_sum_N'])} N"
    return [
        *(_limited(each, bool(goals)) for each in errors),
        *([_plain("settling time", _seconds(m["settling_time_s"]))] if goals else []),
        _plain("squeeze k_f", f"{_number(m['final_grasp_force_N'])} N"),
        _plain(
            "sum of normal forces", f"{total}, {_percent(m['normal_force_sum_relative_error'])} off"
        ),
        *(
            _plain(
                f"normal force, {finger}",
                f"{_number(force)} N, k_f f* = {_number(m['optimal_normal_forces_N'][finger])} N",
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
    if _is_lockstep(plan) or commands is None:
        return []
    return [_plain("ticks answered", str(commands["ticks"]))]


def _seconds(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g} s"


def deadlines_of(plan: Plan, outcome: RunOutcome) -> Deadlines | None:
    """Return how a run kept to real time, None in lockstep and where it did not begin."""
    if _is_lockstep(plan) or outcome.last_tick < 0:
        return None
    reached = 1e-9 * outcome.last_tick
    asked = reached if plan.interactive else plan.scenario.duration
    return read_deadlines(outcome.plant, plan.scenario.plant.rate, asked, reached)


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


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g}"


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:{'.0f' if value >= 0.1 else '.2g'}} %"
