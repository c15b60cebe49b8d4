# SPDX-License-Identifier: Apache-2.0
"""Read the results of a run from its bag, judge, write and show them."""

from __future__ import annotations

import datetime
import json
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.table import Table

from tactile_hand_ros.bag.provenance import LOST_KEY, versions
from tactile_hand_ros.errors import TactileHandError, counted
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.page import write_report
from tactile_hand_ros.run.metrics import DROPPED, NOT_REACHED, REACHED, STEERED, Metrics, json_ready
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP

EXIT_DROPPED = 3
INCOMPLETE = "incomplete"
_CTRL_C = 130  # exit code
# Rows of the metrics table that are shown with their goals instead.
_JUDGED = ("final position error", "final rotation error", "longest slip", "goal")


@dataclass
class RunResults:
    """The contents of a run's bag, None or empty without a bag or a tick, and its problems."""

    run: Run | None = None
    metrics: Metrics | None = None
    recording: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_results(plan: Plan, directory: RunDirectory, outcome: RunOutcome) -> RunResults:
    """Compute the results from the bag; a complete run must contain all ticks."""
    if not plan.record:
        return RunResults()
    try:
        run = Run(directory.path, namespace=plan.namespace, steered=plan.interactive)
        recording = asdict(run.bag_metrics)
        results = RunResults(run, run.metrics, recording)
    except TactileHandError as error:
        return RunResults(problems=[str(error)])
    ticks, lost = run.metrics.ticks, run.lost_messages or 0
    # In real time a late plant skips ticks.
    is_whole = _is_lockstep(plan) and not (outcome.failure or outcome.interrupted)
    expected = plan.scenario.ticks if is_whole else None
    recording |= {"expected_ticks": expected, LOST_KEY: lost}
    # The table and `tactile-hand summary` list the topics.
    if recording["absent"] or (_is_lockstep(plan) and not recording["complete"]):
        results.problems.append("the recording is incomplete: topics or ticks are missing")
    if expected not in (None, ticks):
        results.problems.append(f"the bag holds {ticks} ticks, expected {expected}")
    if lost:
        results.problems.append(f"the recorder lost {counted(lost, 'message')}")
    return results


def _is_lockstep(plan: Plan) -> bool:
    return plan.scenario.plant.pacing == "lockstep"


def real_time_counts(plan: Plan, outcome: RunOutcome) -> dict[str, float] | None:
    """Return how a run kept to real time, None in lockstep and for a run that did not start.

    Of the ticks due by the wall clock: `late`, the command came after the next tick was due, or
    never; `skipped`, due together with a later one, or while the machine stalled. The plant's last
    report may be slightly older than the end.
    """
    if _is_lockstep(plan) or outcome.last_tick < 0:
        return None
    keys = ("time_s", "lost_s", "late_commands", "missed_ticks")
    time, lost, late, missed = (float(outcome.plant.get(key, "nan")) for key in keys)
    rate = plan.scenario.plant.rate
    skipped, due = missed + round(lost * rate), (time + lost) * rate
    fraction = min(1.0, (late + skipped) / due) if due > 0.0 else float("nan")
    return {"rate_hz": rate, "late": late, "skipped": skipped, "missed_fraction": fraction}


@dataclass(frozen=True)
class RunVerdict:
    """The verdict on a run, with the reasons for any outcome but success.

    The outcome is ``goal reached``, ``goal not reached``, ``object dropped``, ``incomplete`` (the
    goal was reached, but data is missing), ``finished`` (a user ended it, or there is no bag to
    judge it by), ``interrupted`` or ``failed``.
    """

    outcome: str
    reasons: list[str]
    exit_code: int


def judge(plan: Plan, outcome: RunOutcome, results: RunResults, signal_code: int) -> RunVerdict:
    """Judge a run; `signal_code` is the exit code if a signal ended it."""
    # An interrupt before the first tick explains an empty bag.
    metrics = results.metrics
    expected = metrics is not None or not outcome.interrupted
    troubles = [*(results.problems if expected else []), *outcome.complaints]
    if outcome.failure:
        return RunVerdict("failed", [outcome.failure, *troubles], 1)
    ended = outcome.interrupted and plan.interactive and signal_code == _CTRL_C
    if outcome.interrupted and not ended:
        return RunVerdict("interrupted", troubles, signal_code)
    if metrics is not None and metrics.is_dropped:
        reason = f"the object was dropped at t = {metrics.dropped_at_s:.3f} s"
        return RunVerdict(DROPPED, [reason, *troubles], EXIT_DROPPED)
    if ended or not plan.record:
        return RunVerdict(STEERED, troubles, 1 if troubles else 0)
    missed = [
        f"the {each.name} is {tables.number(each.value, each.unit)}, the goal is {each.limit:g} "
        f"{each.unit}"
        for each in ([] if metrics is None else metrics.judged(plan.scenario.goal))
        if not each.passed
    ]
    if missed:
        return RunVerdict(NOT_REACHED, [*missed, *troubles], 1)
    return RunVerdict(INCOMPLETE, troubles, 1) if troubles else RunVerdict(REACHED, [], 0)


def in_words(verdict: RunVerdict, results: RunResults) -> str:
    """Return the outcome of a run in a few words, with the time of a drop."""
    if verdict.outcome == DROPPED and results.metrics is not None:
        return results.metrics.headline()
    return verdict.outcome


def write_summary(
    plan: Plan,
    directory: RunDirectory,
    outcome: RunOutcome,
    results: RunResults,
    verdict: RunVerdict,
) -> None:
    """Write ``summary.json`` atomically."""
    scenario, run = plan.scenario, results.run
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
        "metrics": {} if results.metrics is None else results.metrics.to_dict(),
        "assumptions": [] if run is None else [asdict(line) for line in run.assumptions],
        "recording": results.recording,
        "real_time": real_time_counts(plan, outcome),
        "start_to_first_tick_s": outcome.first_tick,
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
    """Return the results as a table for the terminal: goals first, each with pass or fail."""
    out, run = Table(), results.run
    for column in ("result", "value", "goal", ""):
        out.add_column(column)
    if run is None:
        return out
    if run.earlier:
        out.add_row("all numbers", "since the last reset")
    has_goal = not plan.interactive and not run.metrics.is_dropped
    for each in run.metrics.judged(plan.scenario.goal) if has_goal else ():
        goal = (f"< {1e3 * each.limit:g} m{each.unit}", "pass" if each.passed else "fail")
        is_limited = each.limit < UNLIMITED_SLIP
        out.add_row(each.name, tables.milli(each.value, each.unit), *(goal if is_limited else ()))
    for name, value in tables.metrics_rows(run.metrics) + tables.bag_rows(run.bag_metrics):
        if name not in (_JUDGED if has_goal else _JUDGED[-1:]):
            out.add_row(name, value)
    lost = results.recording[LOST_KEY]
    out.add_row("lost messages", str(lost), "none", "fail" if lost else "pass")
    if (kept := real_time_counts(plan, outcome)) is not None:
        counts = f"{kept['late']:.0f} late, {kept['skipped']:.0f} skipped"
        out.add_row("deadlines missed", f"{100.0 * kept['missed_fraction']:.2f} %, {counts}")
    first = outcome.first_tick
    out.add_row("start to first tick", "unknown" if first is None else f"{first:.4g} s")
    return out


def report_line(run: Run) -> str:
    """Write the report and return a line with its path or the error, which must not fail a run."""
    try:
        return f"report: {write_report(run)}"
    except Exception as error:
        return f"the report was not written: {error or type(error).__name__}"
