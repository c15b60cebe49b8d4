# SPDX-License-Identifier: Apache-2.0
"""The results of a run, read from its bag, and what is missing in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tactile_hand_ros.errors import TactileHandError, counted
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.run.recording import Deadlines, read_deadlines
from tactile_hand_ros.run.run import Run

LOST_KEY = "lost_messages"


@dataclass
class Results:
    """What the bag says.

    Attributes:
        metrics: `Run.metrics` as plain data, empty without a bag or a tick.
        recording: Message counts against ticks, empty without a bag or a tick.
        problems: A sentence for each thing that is wrong with the bag.
        assumptions: `Run.assumptions` as plain data.
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
        results.assumptions = [line.to_dict() for line in run.assumptions]
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
    return plan.scenario.ticks if is_lockstep(plan) else None


def is_lockstep(plan: Plan) -> bool:
    """Return whether time waits for the answers."""
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
        if c["complete"] is False and is_lockstep(plan)
    }
    for count in sorted(set(short.values())):
        topics = ", ".join(topic for topic, present in short.items() if present == count)
        found.append(f"the bag has {count} of {ticks} ticks on {topics}")
    return found


def deadlines_of(plan: Plan, outcome: RunOutcome) -> Deadlines | None:
    """Return how a run kept to real time, None in lockstep and where it did not begin."""
    if is_lockstep(plan) or outcome.last_tick < 0:
        return None
    reached = 1e-9 * outcome.last_tick
    asked = reached if plan.interactive else plan.scenario.duration
    return read_deadlines(outcome.plant, plan.scenario.plant.rate, asked, reached)
