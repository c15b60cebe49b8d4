# SPDX-License-Identifier: Apache-2.0
"""A study is a space, a sampler, a function that makes one run, and a reduction of all results."""

from __future__ import annotations

import functools
import hashlib
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import tactile_hand_ros
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.sweep.samplers import SAMPLERS, Design
from tactile_hand_ros.sweep.space import Space

_SLICE = 4096  # runs whose shares are drawn at a time


class StudyError(TactileHandError):
    """A study that cannot go on; what was finished is kept."""


@dataclass(frozen=True, slots=True)
class Point:
    """One run that is to be made.

    Attributes:
        index: Number of the run in its study.
        seed: Follows from the study's seed and the index.
        values: The parameters.
    """

    index: int
    seed: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Failure:
    """A run that came to no result, and why."""

    reason: str


Result = tuple[Point, Any]
"""A run and what came of it."""


def results_of(results: Iterable[Result]) -> Iterator[Any]:
    """Yield what came of each run, where no run may fail.

    Raises:
        StudyError: If one has failed.
    """
    for _, result in results:
        if isinstance(result, Failure):
            raise StudyError(result.reason)
        yield result


def in_order(results: Iterable[Result]) -> Iterator[Any]:
    """Yield what came of each run, the first run first, where no run may fail.

    Raises:
        StudyError: If one has failed.
    """
    early: dict[int, Any] = {}
    following = 0
    for point, result in results:
        early[point.index] = next(results_of([(point, result)]))
        while following in early:
            yield early.pop(following)
            following += 1


@dataclass(frozen=True)
class Study:
    """A description of many runs.

    Attributes:
        space: What is varied.
        sampler: Name of one of `SAMPLERS`.
        run: Makes one run; pickled, and called in other processes.
        reduce: Takes each run and its result or `Failure`, in any order, and returns what the study
            shows.
        runs: Number of runs; a sampler with a structure of its own comes as close as it can.
        seed: Of the sampler and of all runs.
    """

    space: Space
    sampler: str
    run: Callable[[Point], Any]
    reduce: Callable[[Iterable[Result]], Any]
    runs: int = 0
    seed: int = 0

    @functools.cached_property
    def design(self) -> Design:
        """The points of the study in the unit cube."""
        return SAMPLERS[self.sampler](self.space, self.runs, self.seed)

    def points(self, skip: Callable[[int], bool] = lambda _: False) -> Iterator[Point]:
        """Yield the runs in order, a slice of them in memory at a time.

        Args:
            skip: Returns whether a run is done already.
        """
        total = self.design.runs
        for first in range(0, total, _SLICE):
            last = min(first + _SLICE, total)
            for index, shares in enumerate(self.design.rows(first, last), first):
                if not skip(index):
                    yield self._point(index, shares)

    def point(self, index: int) -> Point:
        """Return one run.

        Raises:
            StudyError: If the study has no such run.
        """
        if not 0 <= index < self.design.runs:
            raise StudyError(
                f"there is no run {index}, expected a number from 0 to {self.design.runs - 1}."
            )
        return self._point(index, self.design.rows(index, index + 1)[0])

    def _point(self, index: int, shares: Any) -> Point:
        seed = int(np.random.SeedSequence([self.seed, index]).generate_state(1)[0])
        return Point(index, seed, self.space.values(shares))


class Batch(NamedTuple):
    """What a worker hands back.

    Attributes:
        results: The runs and their results.
        seconds: How long they took together.
        build: Which sources the worker ran.
    """

    results: list[Result]
    seconds: float
    build: str


def run_batch(run: Callable[[Point], Any], points: Sequence[Point], expected: str) -> Batch:
    """Make some runs one after the other; a run that fails says why and stops no other.

    Args:
        run: Makes one run.
        points: The runs.
        expected: Build of the driver; with another one nothing is run.
    """
    if build() != expected:
        return Batch([], 0.0, build())
    start = time.perf_counter()
    results = [(point, _attempt(run, point)) for point in points]
    return Batch(results, time.perf_counter() - start, expected)


def _attempt(run: Callable[[Point], Any], point: Point) -> Any:
    try:
        return run(point)
    except TactileHandError as error:
        return Failure(str(error))
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return Failure(f"{type(error).__name__}: {error} ({where})")


@functools.cache
def build() -> str:
    """Return version and fingerprint of the installed sources: equal ones give equal bits."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return f"{tactile_hand_ros.__version__}+{digest.hexdigest()[:8]}"
