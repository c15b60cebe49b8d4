# SPDX-License-Identifier: Apache-2.0
"""Run studies in parallel with joblib, on all cores or on the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import functools
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.space import Space, points

_PATIENCE = 10.0  # s, longest wait for a scheduler

REACHED, MISSED, LOST, FAILED = "reached", "missed", "lost", "failed"
OUTCOMES = (REACHED, MISSED, LOST, FAILED)
"""Outcomes of a run: goal reached; object held, but not at its target or after too much slip; a
contact missing at the end; error."""


class StudyError(TactileHandError):
    """A study that cannot continue; its finished runs are kept."""


@dataclass(frozen=True, slots=True)
class Point:
    """One run of a study; its seed follows from the study's seed and the index."""

    index: int
    seed: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """Many runs of a function of a point, which is pickled and called in other processes.

    Attributes:
        space: The varied parameters.
        run: The function.
        runs: Number of runs, if a parameter is a range.
        seed: Seed of the points and of all runs.
        description: Other properties that identify the study, plain data for JSON.
    """

    space: Space
    run: Callable[[Point], Any]
    runs: int = 0
    seed: int = 0
    description: Mapping[str, Any] = field(default_factory=dict)

    @functools.cached_property
    def fractions(self) -> Any:
        """The points of the study in the unit cube, shape (n, d)."""
        return points(self.space, self.runs, self.seed)

    def point(self, index: int) -> Point:
        """Return one point of the study."""
        seed = int(np.random.SeedSequence([self.seed, index]).generate_state(1)[0])
        pairs = zip(self.space.items(), self.fractions[index].tolist(), strict=True)
        return Point(index, seed, {name: p.value(fraction) for (name, p), fraction in pairs})

    def results(self, indices: Iterable[int]) -> Iterator[tuple[Point, Any]]:
        """Yield some runs with their results as `in_parallel` does, in any order.

        A run that fails yields its reason, with the outcome `FAILED`, and does not stop the others.
        """
        attempt = functools.partial(_attempt, self.run)
        yield from in_parallel(attempt, map(self.point, indices), ordered=False)


def _attempt(run: Callable[[Point], Any], point: Point) -> tuple[Point, Any]:
    try:
        return point, run(point)
    except TactileHandError as error:
        reason = str(error)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        reason = f"{type(error).__name__}: {error} ({where})"
    return point, {"outcome": FAILED, "reason": reason}


def in_parallel(
    function: Callable[[Any], Any], items: Iterable[Any], *, ordered: bool = True
) -> Iterator[Any]:
    """Yield the result of a function for each item, on the cores of this machine or of `workers`.

    Args:
        function: Pickled, and called in other processes.
        items: Its arguments; a few are taken in advance.
        ordered: Whether results keep the order of the items, or are yielded once they are ready.

    Raises:
        MissingLibraryError: If joblib is not installed.
        StudyError: If processes die.
    """
    joblib = optional("joblib", "Running on several cores")
    parallel = joblib.Parallel(return_as="generator" if ordered else "generator_unordered")
    try:
        yield from parallel(joblib.delayed(function)(item) for item in items)
    except BrokenProcessPool:
        raise StudyError(
            "a process died during a run (out of memory?); use fewer --jobs, or find the "
            "run with --jobs 1."
        ) from None


@contextlib.contextmanager
def workers(jobs: int = -1, cluster: str = "") -> Iterator[None]:
    """Choose where `in_parallel` runs inside the context.

    Args:
        jobs: Number of local processes; -1 for one on each core.
        cluster: Address of the scheduler of a Dask cluster instead.

    Raises:
        MissingLibraryError: If joblib or Dask is not installed.
        StudyError: If there is no such cluster.
    """
    joblib = optional("joblib", "Running on several cores")
    if not cluster:
        ignore = (signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent process
        options = {"initializer": signal.signal, "initargs": ignore}
        with joblib.parallel_config("loky", n_jobs=jobs, **options):
            yield
        return
    distributed = optional("distributed", "Running on a Dask cluster")
    try:
        distributed.comm.get_address_host_port(cluster)  # a client with a wrong one ends badly
        client = distributed.Client(cluster, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        raise StudyError(
            f"no Dask scheduler answers at {cluster} ({error}); start one with `dask scheduler`, "
            "and name its address with the port, as tcp://127.0.0.1:8786."
        ) from None
    with client, joblib.parallel_config(backend="dask", client=client, n_jobs=-1):
        yield
