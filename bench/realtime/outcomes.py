# SPDX-License-Identifier: Apache-2.0
"""Scenarios in real time: did the hand keep the object, how far did it slip, at what squeeze."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from bench.realtime.cases import rate_options
from bench.runs import BenchError, GraphRun, run_graph
from tactile_hand_ros.scenario.scenario import load_scenario

LOCKSTEP, REALTIME = "lockstep", "realtime"


@dataclass(frozen=True)
class ScenarioCase:
    """One way to run a scenario.

    Attributes:
        scenario: Its name or file.
        pacing: ``lockstep`` or ``realtime``.
        rate: Ticks per second [Hz].
        composed: Whether the nodes share a process.
        duration: Simulated time [s].
        priority: Under SCHED_FIFO; 0 for ordinary scheduling.
    """

    scenario: str
    pacing: str
    rate: float
    composed: bool
    duration: float
    priority: int = 0

    def __str__(self) -> str:
        """Return it in words."""
        where = "composed" if self.composed else "processes"
        return f"{self.scenario}, {self.pacing}, {self.rate:g} Hz, {where}"

    @property
    def options(self) -> list[str]:
        """Options of the orchestrator."""
        words = ["--scenario", self.scenario, "--pacing", self.pacing, *rate_options(self.rate)]
        words += ["--composed" if self.composed else "--processes"]
        return words + (["--priority", str(self.priority)] if self.priority else [])


@dataclass(frozen=True)
class Outcome:
    """What came of one run; NaN where it is not known.

    Attributes:
        case: The case.
        run: Number of the run, from 0.
        goal: Whether it reached its goal.
        dropped: Whether fewer than two fingers touched at the end.
        slip_mm: Longest way that a contact slid [mm].
        peak_force: Largest k_f [N].
        late: Share of the ticks whose command was late or never came.
        skipped: Share of the ticks that were skipped or given up.
        calls: Ticks per second that the loop made by function calls, just before.
        problem: Why the run failed; empty if it did not.
    """

    case: ScenarioCase
    run: int
    goal: bool
    dropped: bool
    slip_mm: float
    peak_force: float
    late: float
    skipped: float
    calls: float
    problem: str = ""

    def __str__(self) -> str:
        """Return it in words."""
        goal = "goal reached" if self.goal else self.problem or "goal not reached"
        return f"{self.case}, run {self.run + 1}: {goal}"

    @property
    def key(self) -> tuple[ScenarioCase, int]:
        """What identifies it in a file of outcomes."""
        return self.case, self.run


def scenario_cases(
    names: Sequence[str],
    rates: Sequence[float] = (),
    duration: float | None = None,
    priority: int = 0,
) -> list[ScenarioCase]:
    """Return the ways to run scenarios.

    Without rates: in lockstep, in real time at the scenario's own rate and at half of it in one
    process, and at half of it in six.

    Args:
        names: Scenarios by name or file.
        rates: Rates in real time instead, each in one process and in six [Hz].
        duration: Simulated time instead of the scenarios' own [s].
        priority: Under SCHED_FIFO; 0 for ordinary scheduling.

    Raises:
        ConfigurationError: If there is no such scenario.
    """
    found = []
    for name in names:
        scenario = load_scenario(name)
        own, seconds = scenario.plant.rate, duration or scenario.duration
        first = ScenarioCase(name, LOCKSTEP, own, True, seconds)
        real = replace(first, pacing=REALTIME, priority=priority)
        half = replace(real, rate=0.5 * own)
        found += [first]
        if rates:
            chosen = [replace(real, rate=rate) for rate in rates]
            found += [replace(each, composed=where) for each in chosen for where in (True, False)]
        else:
            found += [real, half, replace(half, composed=False)]
    return found


def run_case(case: ScenarioCase, run: int, calls: float) -> Outcome:
    """Run a case once; a run that fails is an outcome too.

    Args:
        case: The case.
        run: Number of the run.
        calls: Ticks per second by function calls in this hour.
    """
    try:
        return outcome_of(case, run, calls, run_graph(case.duration, *case.options))
    except BenchError as error:
        nan = float("nan")
        return Outcome(case, run, False, False, nan, nan, nan, nan, calls, problem=str(error))


def outcome_of(case: ScenarioCase, run: int, calls: float, graph: GraphRun) -> Outcome:
    """Judge a run."""
    metrics = graph.summary["metrics"]
    slid = metrics["max_slip_distance_m"]
    late = skipped = 0.0
    if case.pacing != LOCKSTEP:
        d = graph.deadlines
        late, skipped = d.late / d.due, (d.skipped + d.given_up) / d.due
    return Outcome(
        case,
        run,
        goal=graph.summary["outcome"] == "goal reached",
        dropped=graph.dropped,
        slip_mm=float("nan") if slid is None else 1e3 * slid,
        peak_force=graph.peak_grasp_force,
        late=late,
        skipped=skipped,
        calls=calls,
    )


COLUMNS = (
    "scenario",
    "pacing",
    "Hz",
    "nodes",
    "goal",
    "dropped",
    "slip [mm]",
    "peak k_f [N]",
    "late [%]",
    "skipped [%]",
)


def rows(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Return a row for each case: medians over its runs, and the worst in brackets."""
    by_case: dict[ScenarioCase, list[Outcome]] = {}
    for outcome in outcomes:
        by_case.setdefault(outcome.case, []).append(outcome)
    return [_row(case, some) for case, some in by_case.items()]


def _row(case: ScenarioCase, runs: Sequence[Outcome]) -> list[str]:
    return [
        case.scenario,
        case.pacing,
        f"{case.rate:g}",
        "composed" if case.composed else "processes",
        f"{sum(run.goal for run in runs)}/{len(runs)}",
        str(sum(run.dropped for run in runs)),
        _spread([run.slip_mm for run in runs], 2),
        _spread([run.peak_force for run in runs], 0),
        _spread([100.0 * run.late for run in runs], 1),
        _spread([100.0 * run.skipped for run in runs], 1),
    ]


def _spread(values: Sequence[float], digits: int) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return "unknown"
    middle, worst = f"{np.median(known):.{digits}f}", f"{max(known):.{digits}f}"
    return middle if len(known) == 1 else f"{middle} ({worst})"


def calls_line(outcomes: Sequence[Outcome]) -> str:
    """Return how fast the computer was, and how much that changed."""
    calls = [outcome.calls for outcome in outcomes]
    return (
        f"By function calls the loop made {np.median(calls):.0f} ticks/s in the same hours"
        f" ({min(calls):.0f} to {max(calls):.0f})."
    )


def append(outcome: Outcome, file: Path) -> None:
    """Add an outcome to a file, a line each."""
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(asdict(outcome)) + "\n")


def read(file: Path) -> list[Outcome]:
    """Read the outcomes in a file, none where there is no file; a torn last line is left out."""
    if not file.is_file():
        return []
    found = []
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            data = json.loads(line)
        except ValueError:
            continue
        found.append(Outcome(**{**data, "case": ScenarioCase(**data["case"])}))
    return found
