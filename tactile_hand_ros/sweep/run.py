# SPDX-License-Identifier: Apache-2.0
"""Carry out a sweep and keep its results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tactile_hand_ros.sweep.backends import Backend
from tactile_hand_ros.sweep.keep import Tally, keep
from tactile_hand_ros.sweep.study import Point, Study
from tactile_hand_ros.sweep.sweep import SCENARIO, Sweep


def study_of(sweep: Sweep) -> Study:
    """Return a sweep as a study."""
    return Study(sweep.space, sweep.sampler, sweep.trial, list, sweep.runs, sweep.seed)


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

    def parameters(point: Point) -> dict[str, Any]:
        name, changes = sweep.trial.changes(point)
        return {SCENARIO: name, **changes}

    store = sweep.store(folder)
    return keep(study_of(sweep), store, sweep.description(), parameters, backend, watch)
