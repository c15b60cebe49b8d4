# SPDX-License-Identifier: Apache-2.0
"""Real time: how old the data of a torque are, how many deadlines are missed, how ticks jitter.

The plant itself counts: it alone knows when a tick was due and when its command came.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product

import numpy as np

from tactile_hand_ros.bench.results import Goal, Result
from tactile_hand_ros.bench.runs import GraphRun, busy_cores, run_graph
from tactile_hand_ros.bench.workload import Workload

RATES = (500.0, 1000.0)  # Hz
ALONE, LOADED, FIRST = "alone", "loaded", "loaded, SCHED_FIFO"
CONDITIONS = (ALONE, LOADED, FIRST)
"""Nothing else runs; a busy loop for each core besides; the same with nodes that go before it."""

PRIORITY = 50
_TRY = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"


@dataclass(frozen=True)
class LoadCase:
    """One way to run in real time.

    Attributes:
        rate: Ticks per second [Hz].
        composed: Whether all nodes but the recorder share a process.
        condition: One of `CONDITIONS`.
    """

    rate: float
    composed: bool
    condition: str = ALONE

    @property
    def where(self) -> str:
        """In how many processes the nodes run."""
        return "composed" if self.composed else "six processes"

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.rate:g} Hz, {self.where}, {self.condition}"

    @property
    def options(self) -> list[str]:
        """Options of the orchestrator."""
        words = ["--pacing", "realtime", "--set", f"plant.rate={self.rate:g}"]
        words += ["--composed"] if self.composed else []
        return words + (["--priority", str(PRIORITY)] if self.condition == FIRST else [])


@dataclass(frozen=True)
class RealtimeRun:
    """What came of a case.

    Attributes:
        case: The case.
        ticks: Number of ticks that should have been.
        missed: Share of them whose command came later than the next tick was due, that came due
            together with a later one, that were given up, or that never came as the run failed.
        run: Ages, jitter, memory and processor time.
    """

    case: LoadCase
    ticks: int
    missed: float
    run: GraphRun


def cases() -> list[LoadCase]:
    """Return all cases that this machine permits."""
    conditions = CONDITIONS if may_go_first() else CONDITIONS[:-1]
    return [LoadCase(*each) for each in product(RATES, (False, True), conditions)]


def may_go_first() -> bool:
    """Return whether processes may use SCHED_FIFO here."""
    return subprocess.run([sys.executable, "-c", _TRY], capture_output=True).returncode == 0


def run_cases(
    chosen: Sequence[LoadCase], seconds: float, progress: Callable[[str], None] = lambda _: None
) -> Iterator[RealtimeRun]:
    """Run cases one after the other.

    Args:
        chosen: The cases.
        seconds: How long each runs [s].
        progress: Called with the name of each that is done.
    """
    for case in chosen:
        yield run_load_case(case, seconds)
        progress(str(case))


def run_load_case(case: LoadCase, seconds: float) -> RealtimeRun:
    """Run one case.

    Raises:
        BenchError: If the run did not come to its end.
    """
    with ExitStack() as stack:
        if case.condition != ALONE:
            stack.enter_context(busy_cores(os.cpu_count() or 1))
        run = run_graph(seconds, *case.options)
    return summed_up(case, seconds, run)


def summed_up(case: LoadCase, seconds: float, run: GraphRun) -> RealtimeRun:
    """Judge a run by what its plant counted; what it did not tell is NaN."""
    ticks = round(seconds * case.rate)

    def said(key: str) -> float:
        return float(run.plant.get(key, "nan"))

    given_up = said("lost_s") * case.rate
    never_came = ticks - said("time_s") * case.rate
    missed = said("late_commands") + said("missed_ticks") + given_up + never_came
    share = float(np.minimum(1.0, missed / ticks))
    return RealtimeRun(case, ticks, share, run)


def results(runs: Sequence[RealtimeRun]) -> list[Result]:
    """Sum up runs; the goals are for 500 Hz and a machine that does nothing else."""
    return [result for run in runs for result in _results_of(run)]


def _results_of(run: RealtimeRun) -> list[Result]:
    name, asked = f"real time, {run.case}", run.case == LoadCase(RATES[0], run.case.composed)
    age = (Goal("median", at_most=1000.0), Goal("p99", at_most=2000.0)) if asked else ()
    few = (Goal("largest", at_most=0.1),) if asked else ()
    return [
        Result.of(f"{name}: age of the data", "us", 1e6 * run.run.ages, *age),
        Result.of(f"{name}: missed deadlines", "%", [100.0 * run.missed], *few),
        Result.of(f"{name}: jitter of the ticks", "us", 1e6 * run.run.jitter),
        Result.of(f"{name}: cores", "", [run.run.cores]),
        Result.of(f"{name}: resident memory", "MiB", [sum(run.run.memory.values())]),
    ]


def measure_realtime(work: Workload) -> list[Result]:
    """Run at 500 Hz without load, in six processes and composed, as long as the scenario takes."""
    chosen = [LoadCase(RATES[0], composed) for composed in (False, True)]
    return results(list(run_cases(chosen, float(work.record.times[-1]))))
