# SPDX-License-Identifier: Apache-2.0
"""A function on all cores, and a Ctrl-C that only this process answers."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from tactile_hand_ros.extras import optional


def parallel(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int, *, ordered: bool
) -> Iterator[Any]:
    """Call a function with the arguments of each task and yield what is done.

    Args:
        function: It and its arguments must be picklable.
        tasks: The arguments of each call.
        jobs: Number of processes; -1 for one on each core.
        ordered: Whether the results come in the order of the tasks.

    Raises:
        MissingLibraryError: If joblib is not installed.
    """
    joblib = optional("joblib", "Running on several cores")
    kind = "generator" if ordered else "generator_unordered"
    work = joblib.Parallel(n_jobs=jobs, return_as=kind)
    with _interrupts_held_back():
        results = work(joblib.delayed(function)(*task) for task in tasks)
    yield from results  # joblib ends its processes when this is left early


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
