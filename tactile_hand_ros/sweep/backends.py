# SPDX-License-Identifier: Apache-2.0
"""Where the runs of a study are made: processes of this machine by joblib, a cluster by Dask.

A backend takes batches from an iterator, a few more than it has workers, and yields what comes
back in the order in which it is done. A worker that is lost costs its batches, which are made
again by another one.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.study import (
    Batch,
    Failure,
    Point,
    StudyError,
    build,
    run_batch,
)

Points = Sequence[Point]
_AHEAD = 2  # batches per worker that wait or run
_TRIES = 4  # of a batch whose worker is lost


class Backend(Protocol):
    """What makes runs."""

    @property
    def workers(self) -> int:
        """Number of runs that are made at the same time."""

    def map(self, run: Callable[[Point], Any], batches: Iterator[Points]) -> Iterator[Batch]:
        """Yield what comes of each batch, as soon as it is done.

        Raises:
            StudyError: If the runs cannot be made.
        """


@dataclass(frozen=True)
class Local:
    """Processes of this machine.

    Attributes:
        jobs: Number of processes; -1 for one on each core.
    """

    jobs: int = -1

    @property
    def workers(self) -> int:
        """Number of processes."""
        cores: int = optional("joblib", "Running on several cores").cpu_count()
        return max(1, self.jobs if self.jobs > 0 else cores + 1 + self.jobs)

    def map(self, run: Callable[[Point], Any], batches: Iterator[Points]) -> Iterator[Batch]:
        """Yield what comes of each batch.

        Raises:
            MissingLibraryError: If joblib is not installed.
            StudyError: If processes die again and again.
        """
        joblib = optional("joblib", "Running on several cores")
        lost = optional("joblib.externals.loky.process_executor", "").TerminatedWorkerError
        waiting: dict[int, Points] = {}  # by the first run of each
        again: list[Points] = []
        for attempt in range(_TRIES):
            tasks = _noted(waiting, again, batches)
            work = joblib.Parallel(
                n_jobs=self.workers,
                return_as="generator_unordered",
                batch_size=1,
                pre_dispatch=_AHEAD * self.workers,
            )
            try:
                with _interrupts_held_back():
                    done = work(joblib.delayed(_keyed)(run, points, build()) for points in tasks)
                for key, batch in done:
                    waiting.pop(key)
                    yield batch
                return
            except lost:
                again = list(waiting.values())
                if attempt == _TRIES - 1:
                    raise StudyError(_dead(again)) from None


def _keyed(run: Callable[[Point], Any], points: Points, expected: str) -> tuple[int, Batch]:
    return points[0].index, run_batch(run, points, expected)


def _noted(
    waiting: dict[int, Points], again: list[Points], batches: Iterator[Points]
) -> Iterator[Points]:
    """Yield batches, those that were lost first, and note each until it has come back."""
    yield from again
    for points in batches:
        waiting[points[0].index] = points
        yield points


def _dead(batches: list[Points]) -> str:
    runs = sorted(point.index for points in batches for point in points)
    listed = ", ".join(map(str, runs[:5])) + (", ..." if len(runs) > 5 else "")
    return (
        f"a process died {_TRIES} times while it made one of the runs {listed} (out of memory?); "
        "use fewer --jobs, or look at one of them with --rerun."
    )


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Hold Ctrl-C back for a moment.

    Processes started inside never see it, so that only this one answers, instead of each with a
    traceback.
    """
    # Its start would let Ctrl-C through again.
    optional("joblib.externals.loky.backend.resource_tracker", "").ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@dataclass
class Cluster:
    """The workers of a Dask cluster.

    Attributes:
        address: Address of the scheduler, as ``tcp://127.0.0.1:8786``, or its scheduler file.
        timeout: Longest wait for the scheduler, and for a first worker, s.
    """

    address: str
    timeout: float = 10.0

    def __post_init__(self) -> None:
        """Connect, and compare the workers' sources with ours.

        Raises:
            MissingLibraryError: If Dask is not installed.
            StudyError: If there is no scheduler, no worker, or a worker with other sources.
        """
        distributed = optional("distributed", "Running on a Dask cluster")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # we say it in a sentence
        place = (
            {"scheduler_file": self.address}
            if os.path.exists(self.address) or self.address.endswith(".json")
            else {"address": self.address}
        )
        if "scheduler_file" in place and not Path(self.address).is_file():
            raise StudyError(f"there is no scheduler file {self.address}; start dask-scheduler.")
        if "address" in place and not re.search(r":\d+$", self.address):
            # A client that was made in vain says so at its end, in a traceback.
            raise StudyError(
                f"--cluster is '{self.address}', expected an address with its port, as "
                "tcp://127.0.0.1:8786, or a scheduler file."
            )
        try:
            self._client = distributed.Client(**place, timeout=self.timeout, set_as_default=False)
            self._client.wait_for_workers(1, timeout=self.timeout)
        except (OSError, ValueError) as error:  # a TimeoutError is an OSError
            if hasattr(self, "_client"):
                self._client.close()
                raise StudyError(
                    f"the scheduler at {self.address} has no worker after {self.timeout:g} s; "
                    f"start some: dask worker {self.address}."
                ) from None
            raise StudyError(
                f"no Dask scheduler answers at {self.address} ({_first_line(error)}); start one "
                "with `dask scheduler`, or leave --cluster away to run on this machine."
            ) from None
        self._check()

    def _check(self) -> None:
        """Refuse workers with other sources, before anything is run."""
        for worker, found in self._client.run(_build_of_worker, on_error="return").items():
            _refuse(found if isinstance(found, str) else _first_line(found), f"worker {worker}")

    @property
    def workers(self) -> int:
        """Number of threads of all workers at present."""
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def map(self, run: Callable[[Point], Any], batches: Iterator[Points]) -> Iterator[Batch]:
        """Yield what comes of each batch.

        Raises:
            StudyError: If a worker that has joined has other sources, or the scheduler is gone.
        """
        distributed = optional("distributed", "Running on a Dask cluster")
        sent: dict[Any, Points] = {}
        done = distributed.as_completed(loop=self._client.loop, raise_errors=False)

        def send(points: Points) -> None:
            future = self._client.submit(
                run_batch, run, points, build(), pure=False, retries=_TRIES - 1
            )
            sent[future] = points
            done.add(future)

        try:
            for _ in range(_AHEAD * self.workers):
                if points := next(batches, None):
                    send(points)
            for future in done:
                points = sent.pop(future)
                result = self._result(future, points)
                if isinstance(result, list):
                    for part in result:
                        send(part)
                    continue
                _refuse(result.build, "a worker that has joined")
                # Workers may have joined: keep as many as there are busy.
                while len(sent) < _AHEAD * self.workers and (more := next(batches, None)):
                    send(more)
                yield result
        finally:
            with contextlib.suppress(Exception):
                self._client.cancel(list(sent))

    def _result(self, future: Any, points: Points) -> Batch | list[Points]:
        """Return what came of a batch, or smaller batches in its place if it kills its workers."""
        if future.status == "finished":
            result: Batch = future.result()
            return result
        if future.status == "cancelled":
            raise StudyError(
                f"the scheduler at {self.address} is gone; what was finished is kept, repeat the "
                "command to go on."
            )
        reason = _first_line(future.exception())
        if len(points) > 1:
            return [[point] for point in points]
        return Batch([(points[0], Failure(f"its workers died: {reason}"))], 0.0, build())

    def close(self) -> None:
        """Leave the cluster; its workers stay."""
        self._client.close()


def _build_of_worker() -> str:
    return build()


def _refuse(found: str, worker: str) -> None:
    if found != build():
        raise StudyError(
            f"{worker} runs tactile_hand_ros {found}, this is {build()}; install the same sources "
            "there, or equal seeds would not give equal results."
        )


def _first_line(error: Any) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
