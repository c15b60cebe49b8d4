# SPDX-License-Identifier: Apache-2.0
"""The results of a run: read from its bag, judged, written and shown."""

from __future__ import annotations

import datetime
import json
import math
import webbrowser
from dataclasses import dataclass, field
from typing import Any

from rich.table import Table

from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.errors import TactileHandError, counted
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.page import REPORT, write_report
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.run.recording import RealTimeCounts, real_time_counts
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
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP

EXIT_DROPPED = 3
INCOMPLETE = "incomplete"
LOST_KEY = "lost_messages"
_CTRL_C = 130  # exit code
_JUDGED = ("final position error", "final orientation error |r_d|", "longest slip", "goal")
"""Rows of the metrics that the table shows with their goals instead."""


@dataclass
class RunResults:
    """What the bag of a run contains.

    Attributes:
        run: The run as it was read, None without a bag or a tick.
        metrics: `Run.metrics` as plain data, empty without a bag or a tick.
        recording: Message counts against ticks, empty without a bag or a tick.
        problems: A sentence for each thing that is wrong with the bag.
    """

    run: Run | None = None
    metrics: dict[str, Any] = field(default_factory=dict)
    recording: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_results(plan: Plan, directory: RunDirectory, *, finished: bool) -> RunResults:
    """Compute the results from the bag.

    Args:
        plan: What was to be run.
        directory: The run.
        finished: Whether all ticks must be there.
    """
    if not plan.record:
        return RunResults()
    try:
        run = Run(directory.path, namespace=plan.namespace, steered=plan.interactive)
        results = RunResults(run, run.metrics.to_dict(), run.bag_metrics.to_dict())
    except TactileHandError as error:
        return RunResults(problems=[str(error)])
    ticks = results.metrics["ticks"]
    # In real time a late plant skips ticks.
    expected = plan.scenario.ticks if finished and _is_lockstep(plan) else None
    lost = int(run.summary.custom_data.get(LOST_KEY, "0"))
    results.recording |= {"expected_ticks": expected, LOST_KEY: lost}
    results.problems += _incomplete(plan, results.recording, ticks)
    if expected not in (None, ticks):
        results.problems.append(f"the bag holds {ticks} ticks, expected {expected}")
    if lost:
        results.problems.append(f"the recorder lost {counted(lost, 'message')}")
    return results


def _is_lockstep(plan: Plan) -> bool:
    return plan.scenario.plant.pacing == "lockstep"


def _incomplete(plan: Plan, recording: dict[str, Any], ticks: int) -> list[str]:
    """Return which topics lack messages, in one sentence for all that lack the same."""
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


def deadlines_of(plan: Plan, outcome: RunOutcome) -> RealTimeCounts | None:
    """Return how a run kept to real time, None in lockstep and where it did not start."""
    if _is_lockstep(plan) or outcome.last_tick < 0:
        return None
    reached = 1e-9 * outcome.last_tick
    wanted = reached if plan.interactive else plan.scenario.duration
    return real_time_counts(outcome.plant, plan.scenario.plant.rate, wanted, reached)


@dataclass(frozen=True)
class RunVerdict:
    """How a run is judged.

    Attributes:
        outcome: ``goal reached``, ``goal not reached``, ``object dropped``, ``incomplete`` (the
            goal was reached, but something is missing), ``finished`` (a user ended it),
            ``interrupted``, ``failed``.
        reasons: Sentences that explain any other outcome than success.
        exit_code: Of the orchestrator.
    """

    outcome: str
    reasons: list[str]
    exit_code: int


def judge(plan: Plan, outcome: RunOutcome, results: RunResults, signal_code: int) -> RunVerdict:
    """Judge a run.

    Args:
        plan: What was to be run.
        outcome: What the orchestrator saw.
        results: What the bag contains.
        signal_code: Exit code if a signal ended it.
    """
    # A run that was interrupted before its first tick lacks nothing that it should have.
    expected = results.metrics or not outcome.interrupted
    troubles = [*(results.problems if expected else []), *outcome.complaints]
    if outcome.failure:
        return RunVerdict("failed", [outcome.failure, *troubles], 1)
    ended = outcome.interrupted and plan.interactive and signal_code == _CTRL_C
    if outcome.interrupted and not ended:
        return RunVerdict("interrupted", troubles, signal_code)
    dropped = results.metrics.get("dropped_at_s")
    if dropped is not None:
        reason = f"the object was dropped at t = {dropped:.3f} s"
        return RunVerdict(DROPPED, [reason, *troubles], EXIT_DROPPED)
    if ended:
        return RunVerdict(STEERED, troubles, 1 if troubles else 0)
    missed = _missed(plan, outcome, results)
    if missed:
        return RunVerdict(NOT_REACHED, [*missed, *troubles], 1)
    return RunVerdict(INCOMPLETE, troubles, 1) if troubles else RunVerdict(REACHED, [], 0)


def _missed(plan: Plan, outcome: RunOutcome, results: RunResults) -> list[str]:
    """Return by how much the goal was missed; without a bag, by the last pose that was seen."""
    goal = plan.scenario.goal
    if results.metrics:
        checks = judged(results.metrics, goal)
    else:
        seen = None if math.isnan(outcome.position_error) else outcome.position_error
        checks = [Judged("final position error", seen, goal.position_error, "m")]
    return [
        f"the {each.name} is {'unknown' if each.value is None else f'{each.value:.4g}'} "
        f"{each.unit}, the goal is {each.limit:g} {each.unit}"
        for each in checks
        if not each.passed
    ]


def in_words(verdict: RunVerdict, results: RunResults) -> str:
    """Return what became of a run in a few words, with the time where the object was dropped."""
    return headline(results.metrics) if verdict.outcome == DROPPED else verdict.outcome


def write_summary(
    plan: Plan,
    directory: RunDirectory,
    outcome: RunOutcome,
    results: RunResults,
    verdict: RunVerdict,
) -> None:
    """Write ``summary.json`` completely or not at all."""
    scenario, run, deadlines = plan.scenario, results.run, deadlines_of(plan, outcome)
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
        "assumptions": [] if run is None else [line.to_dict() for line in run.assumptions],
        "recoveries": [] if run is None else [each.to_dict() for each in run.recoveries],
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


def table(plan: Plan, outcome: RunOutcome, results: RunResults) -> Table:
    """Return the results as a table for the terminal: goals first, each passed or failed."""
    out = Table()
    for column in ("result", "value", "goal", ""):
        out.add_column(column)
    run = results.run
    if run is None:
        return out
    if run.earlier:
        out.add_row("all numbers", "since the last reset")
    if not plan.interactive and results.metrics["dropped_at_s"] is None:
        for each in judged(results.metrics, plan.scenario.goal):
            shown = tables.milli(each.value, each.unit)
            if each.limit >= UNLIMITED_SLIP:
                out.add_row(each.name, shown)
                continue
            goal = f"< {1e3 * each.limit:g} m{each.unit}"
            out.add_row(each.name, shown, goal, "pass" if each.passed else "fail")
        skipped: tuple[str, ...] = _JUDGED
    else:
        skipped = _JUDGED[-1:]
    rows = [*tables.metrics_rows(run.metrics), *tables.recovery_rows(run.recoveries)]
    rows += tables.bag_rows(run.bag_metrics)
    for name, value in rows:
        if name not in skipped:
            out.add_row(name, tables.plain(value))
    lost = results.recording[LOST_KEY]
    out.add_row("lost messages", str(lost), "none", "fail" if lost else "pass")
    deadlines = deadlines_of(plan, outcome)
    if deadlines is not None:
        counts = f"{deadlines.late:.0f} late, {deadlines.skipped:.0f} skipped"
        out.add_row("deadlines missed", f"{100.0 * deadlines.missed_fraction:.2f} %, {counts}")
    first = outcome.startup.get("first_tick_answered")
    out.add_row("start to first tick", "unknown" if first is None else f"{first:.4g} s")
    return out


def report_line(run: Run) -> str:
    """Write the report and return a line with its place.

    A page that fails must not cost the run: whatever goes wrong is in the line.
    """
    try:
        return f"report: {write_report(run)}"
    except Exception as error:
        return f"the report was not written: {error or type(error).__name__}"


def open_report(directory: RunDirectory) -> str:
    """Open the report in a browser and return a line about it, or what to do instead."""
    file = (directory.path / REPORT).resolve()
    if not file.is_file():
        return "there is no report to open"
    if webbrowser.open(file.as_uri()):
        return f"opened {file.as_uri()}"
    return f"no browser was found here; open {file.as_uri()} in one"
