# SPDX-License-Identifier: Apache-2.0
"""The slip study: how fast slip is found and stopped, and at what squeeze, over many short runs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from studies.slip.cases import SlipCase, pull_of, sample_cases
from studies.slip.outcomes import HELD, Held, SlipOutcome, hold_case, run_case
from tactile_hand_ros.sweep import study as engine
from tactile_hand_ros.sweep.backends import Backend
from tactile_hand_ros.sweep.runner import carry_out
from tactile_hand_ros.sweep.space import Choice, Space


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


def _run(point: engine.Point) -> tuple[str, SlipOutcome | Held]:
    case, kind = point.values["task"]
    return kind, hold_case(case, kind) if kind in HELD else run_case(case)


def _reduced(seed: int, progress: Callable[[str], None], results: Iterable[engine.Result]) -> Study:
    """Return the study that some results are, whatever their order."""
    found: dict[str, list[Any]] = {kind: [] for kind in ("event", "pull", *HELD)}
    for kind, result in engine.results_of(results):
        found[kind].append(result)
        progress(f"{kind}, run {result.case.index}")
    for some in found.values():
        some.sort(key=lambda result: result.case.index)
    held = [result for kind in HELD for result in found[kind]]
    return Study(seed, found["event"], found["pull"], held)


def run_study(
    runs: int,
    seed: int,
    backend: Backend | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Study:
    """Run the study.

    Args:
        runs: Number of runs with an event.
        seed: The same seed gives the same numbers, on any number of cores.
        backend: Where; all cores of this machine by default.
        progress: Called whenever a run is done.

    Raises:
        MissingLibraryError: If joblib is not installed.
    """
    space = Space({"task": Choice(tuple(tasks_of(runs, seed)))})
    study = engine.Study(space, "grid", _run, functools.partial(_reduced, seed, progress))
    result: Study = carry_out(study, backend)
    return result
