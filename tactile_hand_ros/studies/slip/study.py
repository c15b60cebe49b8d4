# SPDX-License-Identifier: Apache-2.0
"""The slip study: how fast slip is found and stopped, and at what squeeze, over many short runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tactile_hand_ros.studies.parallel import parallel
from tactile_hand_ros.studies.slip.cases import SlipCase, pull_of, sample_cases
from tactile_hand_ros.studies.slip.outcomes import HELD, Held, SlipOutcome, hold_case, run_case


@dataclass(frozen=True)
class Study:
    """All runs.

    Attributes:
        seed: Of the cases.
        outcomes: Runs with an event.
        pulls: 10 N at once on 0.2 kg with mu = 0.5, under the noise and latency of some cases.
        held: Runs that nothing disturbs.
    """

    seed: int
    outcomes: list[SlipOutcome]
    pulls: list[SlipOutcome]
    held: list[Held]


def tasks_of(runs: int, seed: int) -> list[tuple[SlipCase, str]]:
    """Return all runs: those with an event, some with the same pull, and a few held for longer."""
    cases = sample_cases(runs, seed)
    long, same = (cases[:: min(runs, every)] for every in (200, 40))
    # The longest first, so that no core waits for one at the end.
    out = [(case, kind) for kind in sorted(HELD, key=lambda k: -HELD[k]) for case in long]
    out += [(pull_of(case), "pull") for case in same]
    return out + [(case, "event") for case in cases]


def _run(case: SlipCase, kind: str) -> tuple[str, SlipOutcome | Held]:
    return kind, hold_case(case, kind) if kind in HELD else run_case(case)


def run_study(
    runs: int, seed: int, jobs: int = -1, progress: Callable[[str], None] = lambda _: None
) -> Study:
    """Run the study.

    Args:
        runs: Number of runs with an event.
        seed: The same seed gives the same numbers, on any number of cores.
        jobs: Number of processes; -1 for one on each core.
        progress: Called whenever a run is done.

    Raises:
        MissingLibraryError: If joblib is not installed.
    """
    found: dict[str, list[Any]] = {kind: [] for kind in ("event", "pull", *HELD)}
    for kind, result in parallel(_run, tasks_of(runs, seed), jobs, ordered=False):
        found[kind].append(result)
        progress(f"{kind}, run {result.case.index}")
    for results in found.values():
        results.sort(key=lambda result: result.case.index)
    held = [result for kind in HELD for result in found[kind]]
    return Study(seed, found["event"], found["pull"], held)
