# SPDX-License-Identifier: Apache-2.0
"""Carry out a study: batches of about a second, handed to a backend, until all runs are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from tactile_hand_ros.sweep.backends import Backend, Local, Points
from tactile_hand_ros.sweep.study import Point, Result, Study

_SECONDS = 1.0  # that a batch takes: far above the cost of handing it over
_LARGEST = 2000  # runs of a batch, for memory


def carry_out(
    study: Study,
    backend: Backend | None = None,
    skip: Callable[[int], bool] = lambda _: False,
    done: int = 0,
) -> Any:
    """Make all runs of a study and return what its reduction makes of them.

    Args:
        study: What to run; its results are handed to its reduction as they come, in any order.
        backend: Where; all cores of this machine by default.
        skip: Returns whether a run is done already, by its index.
        done: How many are.

    Raises:
        StudyError: If the backend cannot go on.
    """
    where = backend or Local()
    sizes = _Sizes(study.design.runs - done, where.workers)

    def each() -> Iterator[Result]:
        for batch in where.map(study.run, _batches(study.points(skip), sizes)):
            sizes.note(len(batch.results), batch.seconds)
            yield from batch.results

    return study.reduce(each())


class _Sizes:
    """How many runs a batch takes: a second's worth, and less near the end."""

    def __init__(self, left: int, workers: int) -> None:
        """Begin with single runs.

        Args:
            left: Runs to be made.
            workers: That share them.
        """
        self._left, self._workers = left, workers
        self._size = 1

    def next(self) -> int:
        """Return the size of the next batch."""
        size = max(1, min(self._size, self._left // (4 * self._workers)))
        self._left -= size
        return size

    def note(self, runs: int, seconds: float) -> None:
        """Take over how long some runs took."""
        if runs:
            wanted = _SECONDS * runs / max(seconds, 1e-9)
            self._size = int(max(1, min(wanted, 4 * self._size, _LARGEST)))


def _batches(points: Iterator[Point], sizes: _Sizes) -> Iterator[Points]:
    batch: list[Point] = []
    size = sizes.next()
    for point in points:
        batch.append(point)
        if len(batch) >= size:
            yield batch
            batch, size = [], sizes.next()
    if batch:
        yield batch
