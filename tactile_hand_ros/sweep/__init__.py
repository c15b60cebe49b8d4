# SPDX-License-Identifier: Apache-2.0
"""Sweeps: a scenario over any of its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactile_hand_ros.sweep.results import Results


def run(
    scenario: str,
    over: Sequence[str],
    changes: Mapping[str, Any] | None = None,
    *,
    folder: Path | str,
    runs: int = 100,
    seed: int = 0,
    jobs: int = -1,
) -> Results:
    """Run a scenario over ranges of its parameters, on all cores.

    Args:
        scenario: Name or file.
        over: Parameters as on the command line, such as ``plant.object.mass=0.05..0.5``.
        changes: Values that stay the same, by dotted key.
        folder: For the results; an unfinished sweep in it is continued.
        runs: Number of runs, if a parameter is a range without levels.
        seed: Seed of everything random.
        jobs: Number of processes, -1 for one on each core.

    Raises:
        TactileHandError: If a name, path, range or value is invalid.

    Example:
        >>> short, over = {"duration": 0.1, "targets": []}, ["plant.object.mass=0.1..0.2"]
        >>> results = run("paper", over, short, folder="mass", runs=2, jobs=1)
        >>> len(results.column("max_slip_distance_m"))
        2
    """
    from tactile_hand_ros.sweep.engine import workers
    from tactile_hand_ros.sweep.results import Results
    from tactile_hand_ros.sweep.sweep import make_sweep
    from tactile_hand_ros.sweep.table import keep, read_table

    asked = make_sweep(scenario, over, changes or {}, runs=runs, seed=seed)
    with workers(jobs):
        keep(asked, Path(folder))
    return Results(asked, read_table(Path(folder)))
