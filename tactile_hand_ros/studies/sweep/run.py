# SPDX-License-Identifier: Apache-2.0
"""Carry out a sweep: rows go to its folder as they come, and a tally to whoever watches."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_hand_ros.jit.compiled import ensure_compiled
from tactile_hand_ros.studies.engine.backends import Backend
from tactile_hand_ros.studies.engine.runner import carry_out
from tactile_hand_ros.studies.engine.study import Failure, Point, Result, Study, build
from tactile_hand_ros.studies.statistics import share_of
from tactile_hand_ros.studies.sweep.metrics import FAILED, REACHED
from tactile_hand_ros.studies.sweep.sweep import SCENARIO, Sweep


@dataclass
class Tally:
    """How far a sweep is.

    Attributes:
        total: Number of runs.
        before: Runs that were done before it began.
        outcomes: How often each outcome came since.
        began: When, on the clock of `time.monotonic`, s.
    """

    total: int
    before: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    began: float = field(default_factory=time.monotonic)

    @property
    def done(self) -> int:
        """Number of finished runs."""
        return self.before + self.outcomes.total()

    @property
    def rate(self) -> float:
        """Runs per second since the beginning."""
        return self.outcomes.total() / max(time.monotonic() - self.began, 1e-9)

    @property
    def left(self) -> float:
        """Time left, s."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else math.inf

    def __str__(self) -> str:
        """Return how many failed, how fast it goes, and an early look at the result."""
        share, low, high = share_of(self.outcomes[REACHED], self.outcomes.total())
        reached = f"{100 * share:.0f} % ({100 * low:.0f} to {100 * high:.0f}) reach the goal"
        speed = f"{self.rate:.3g} runs/s"
        if math.isnan(share):
            return speed
        return f"{self.outcomes[FAILED]} failed, {speed}, {reached}"


def study_of(sweep: Sweep, reduce: Callable[[Iterable[Result]], Any]) -> Study:
    """Return a sweep as a study."""
    return Study(sweep.space, sweep.sampler, sweep.trial, reduce, sweep.runs, sweep.seed)


def run_sweep(
    sweep: Sweep, folder: Path, backend: Backend, watch: Callable[[Tally], None] = lambda _: None
) -> Tally:
    """Make all runs that are not done yet and write the table of all that are.

    Args:
        sweep: What to run.
        folder: Of its results; holds those of an earlier, unfinished call.
        backend: Where.
        watch: Called after each run.

    Raises:
        StudyError: If the folder holds another study or cannot be written, or the backend fails.
    """
    store = sweep.store(folder)

    def reduce(results: Iterable[Result]) -> None:
        for point, result in results:
            row = _row(sweep, point, result)
            store.add([row])
            tally.outcomes[row["outcome"]] += 1
            watch(tally)

    study = study_of(sweep, reduce)
    total = study.design.runs
    done = store.begin(sweep.description(), total)
    tally = Tally(total, int(done.sum()))
    try:
        if tally.before < total:
            ensure_compiled()
            carry_out(study, backend, lambda index: bool(done[index]), tally.before)
    finally:
        store.finish()
    store.close(total)
    return tally


def _row(sweep: Sweep, point: Point, result: Any) -> dict[str, Any]:
    """Return a finished run as a row of the table."""
    name, changes = sweep.trial.changes(point)
    row = {"run": point.index, SCENARIO: name, "reason": "", "build": build(), **changes}
    if isinstance(result, Failure):
        return {**row, "outcome": FAILED, "reason": result.reason}
    return {**row, **result}
