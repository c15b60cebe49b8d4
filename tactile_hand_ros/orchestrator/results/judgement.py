# SPDX-License-Identifier: Apache-2.0
"""How a run is judged: by its goal, by what is missing, by failures and signals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tactile_hand_ros.orchestrator.results.reading import Results
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.run.verdict import (
    DROPPED,
    NOT_REACHED,
    REACHED,
    STEERED,
    Judged,
    headline,
    judged,
)

EXIT_DROPPED = 3
INCOMPLETE = "incomplete"
_CTRL_C = 130  # exit code


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


def _missed(plan: Plan, outcome: RunOutcome, results: Results) -> list[str]:
    """Say by how much the goal was missed; without a bag, by the last pose that was seen."""
    goal = plan.scenario.goal
    if results.metrics:
        checks = judged(results.metrics, goal)
    else:
        seen = None if math.isnan(outcome.position_error) else outcome.position_error
        checks = [Judged("final position error", seen, goal.position_error, "m")]
    return [
        f"the {each.name} is {number(each.value)} {each.unit}, the goal is {each.limit:g} "
        f"{each.unit}"
        for each in checks
        if not each.passed
    ]


def told(verdict: GoalVerdict, results: Results) -> str:
    """Return what became of a run in a few words, with the time where the object was dropped."""
    if verdict.outcome == DROPPED:
        return headline(results.metrics)
    return verdict.outcome


def number(value: float | None) -> str:
    """Return a number with four digits, or that it is not known."""
    return "unknown" if value is None else f"{value:.4g}"
