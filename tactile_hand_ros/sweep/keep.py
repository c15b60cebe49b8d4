# SPDX-License-Identifier: Apache-2.0
"""Carry out a study whose results are kept: rows go to its folder as they come, and a tally out."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.sweep.backends import Backend
from tactile_hand_ros.sweep.runner import carry_out
from tactile_hand_ros.sweep.statistics import share_of
from tactile_hand_ros.sweep.store import Store
from tactile_hand_ros.sweep.study import Failure, Point, Result, Study, build

REACHED, MISSED, LOST, FAILED = "reached", "missed", "lost", "failed"
OUTCOMES = (REACHED, MISSED, LOST, FAILED)
"""Of a run: the goal was reached; the object is held, but not at its target, or it has slid too
far; a contact is missing at the end; it raised an error."""

LAST_COLUMNS = {"outcome": str, "reason": str, "build": str}


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


def keep(
    study: Study,
    store: Store,
    description: Mapping[str, Any],
    parameters: Callable[[Point], Mapping[str, Any]],
    backend: Backend,
    watch: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Make all runs that are not done yet and write the table of all that are.

    Args:
        study: Whose runs return a mapping of columns, `outcome` among them; its own reduction is
            replaced by one that writes.
        store: Where results go; holds those of an earlier, unfinished call.
        description: Of the study, plain data; a folder holds one study.
        parameters: Returns the columns of a run that are known before it.
        backend: Where runs are made.
        watch: Called after each run.

    Raises:
        StudyError: If the folder holds another study or cannot be written, or the backend fails.
    """

    def write(results: Iterable[Result]) -> None:
        for point, result in results:
            row = {"run": point.index, "reason": "", "build": build(), **parameters(point)}
            if isinstance(result, Failure):
                result = {"outcome": FAILED, "reason": result.reason}
            store.add([{**row, **result}])
            tally.outcomes[result["outcome"]] += 1
            watch(tally)

    total = study.design.runs
    done = store.begin(description, total)
    tally = Tally(total, int(done.sum()))
    try:
        if tally.before < total:
            ensure_compiled()
            writing = replace(study, reduce=write)
            carry_out(writing, backend, lambda index: bool(done[index]), tally.before)
    finally:
        store.finish()
    store.close(total)
    return tally
