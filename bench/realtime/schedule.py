# SPDX-License-Identifier: Apache-2.0
"""Many runs of scenarios, kept in a file as they end, so that they can be stopped and continued."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bench.blocks import function_calls
from bench.realtime.outcomes import (
    LOCKSTEP,
    Outcome,
    ScenarioCase,
    append,
    read,
    run_case,
)


def planned(cases: Sequence[ScenarioCase], runs: int) -> list[tuple[ScenarioCase, int]]:
    """Return what is to be run, all cases in turn before the next round begins.

    Args:
        cases: The cases.
        runs: How often each; those in lockstep only once, since all their runs are identical.
    """
    return [
        (case, run) for run in range(runs) for case in cases if run == 0 or case.pacing != LOCKSTEP
    ]


def run_planned(
    plan: Sequence[tuple[ScenarioCase, int]],
    file: Path,
    limit: float,
    progress: Callable[[str], None] = lambda _: None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Outcome]:
    """Run what a file does not hold yet, and yield all outcomes of the plan.

    Args:
        plan: Cases and numbers of runs.
        file: Where outcomes are kept; each is added when it is there.
        limit: Time after which no further run begins [s].
        progress: Called with the name of each that is there.
        clock: Time [s].
    """
    kept = {outcome.key: outcome for outcome in read(file)}
    end = clock() + limit
    for case, run in plan:
        outcome = kept.get((case, run))
        if outcome is None:
            if clock() >= end:
                continue
            outcome = run_case(case, run, function_calls())
            append(outcome, file)
        progress(str(case))
        yield outcome
