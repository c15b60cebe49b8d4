# SPDX-License-Identifier: Apache-2.0
"""Real time: how old the data of a torque are, how many deadlines are missed and why.

The plant counts: only it knows when a tick was due and when its command came.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product

from bench.realtime.bare_loop import BareLoop, measure_bare_loop
from bench.results import Goal, Result
from bench.runs import GraphRun, busy_cores, run_graph
from bench.workload import Workload
from tactile_hand_ros.run.recording import Deadlines

RATES = (500.0, 1000.0)  # Hz
WHERE = (True, False)  # composed or not
_STEPS = 1000.0  # Hz: beyond this rate a tick is shorter than the ordinary step of the plant
ALONE, FIRST = "alone", "SCHED_FIFO"
LOADED, LOADED_FIRST = "loaded", "loaded, SCHED_FIFO"
CONDITIONS = (ALONE, FIRST, LOADED, LOADED_FIRST)
"""Nothing else runs; the same with real-time priority; both beside a busy loop for each core."""

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
        words = ["--pacing", "realtime", *rate_options(self.rate)]
        words += ["--composed" if self.composed else "--processes"]
        return words + (["--priority", str(self.priority)] if self.priority else [])

    @property
    def priority(self) -> int:
        """Priority under SCHED_FIFO, 0 for ordinary scheduling."""
        return PRIORITY if self.condition in (FIRST, LOADED_FIRST) else 0

    @property
    def is_loaded(self) -> bool:
        """Whether a busy loop for each core competes with it."""
        return self.condition in (LOADED, LOADED_FIRST)


@dataclass(frozen=True)
class RealtimeRun:
    """What came of a case.

    Attributes:
        case: The case.
        missed: Share of the ticks that were late, skipped or given up.
        deadlines: The same in numbers, with causes.
        run: Ages, jitter, memory and processor time.
        bare: What a process that only wakes at each tick achieved just before.
    """

    case: LoadCase
    missed: float
    deadlines: Deadlines
    run: GraphRun
    bare: BareLoop | None = None


def rate_options(rate: float) -> list[str]:
    """Return the options of the orchestrator for a rate, with steps that are short enough."""
    words = ["--set", f"plant.rate={rate:g}"]
    return words + (["--set", f"plant.time_step={1.0 / rate:.12g}"] if rate > _STEPS else [])


def cases(rates: Sequence[float] = RATES, *, loaded: bool = False) -> list[LoadCase]:
    """Return all cases that this machine permits, those of one condition and rate together.

    Args:
        rates: Ticks per second [Hz].
        loaded: Whether to measure beside a busy loop for each core, too.
    """
    chosen = [ALONE, *([FIRST] if may_go_first() else [])]
    if loaded:
        chosen += [LOADED, *([LOADED_FIRST] if may_go_first() else [])]
    return [LoadCase(rate, where, each) for each, rate, where in product(chosen, rates, WHERE)]


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
    """Run a bare loop for a quarter of the time, and then one case.

    Raises:
        BenchError: If the run did not come to its end.
    """
    with ExitStack() as stack:
        if case.is_loaded:
            stack.enter_context(busy_cores(os.cpu_count() or 1))
        bare = measure_bare_loop(case.rate, max(1.0, 0.25 * seconds), case.priority)
        run = run_graph(seconds, *case.options)
    return summed_up(case, run, bare)


def summed_up(case: LoadCase, run: GraphRun, bare: BareLoop | None = None) -> RealtimeRun:
    """Judge a run; what its plant has not reported is NaN."""
    return RealtimeRun(case, run.deadlines.missed_share, run.deadlines, run, bare)


GOALS = {
    LoadCase(500.0, True, ALONE): (1000.0, 0.1),
    LoadCase(1000.0, True, FIRST): (700.0, 0.2),
    LoadCase(500.0, True, LOADED_FIRST): (None, 0.1),
}
"""Upper bounds of the 99th percentile of the age [us] and of the missed deadlines [%]."""

_BARE_FACTOR = 2.0
"""What a bare loop misses on the same computer may be missed so many times."""


def results(runs: Sequence[RealtimeRun]) -> list[Result]:
    """Sum up runs, with goals for one process."""
    return [result for run in runs for result in _results_of(run)]


def _results_of(run: RealtimeRun) -> list[Result]:
    name = f"real time, {run.case}"
    oldest, most = GOALS.get(run.case, (None, None))
    age = () if oldest is None else (Goal("p99", at_most=oldest),)
    bare = _BARE_FACTOR * 100.0 * run.bare.missed if run.bare else 0.0
    few = () if most is None else (Goal("largest", at_most=max(most, bare)),)
    return [
        Result.of(f"{name}: age of the data", "us", 1e6 * run.run.ages, *age),
        Result.of(f"{name}: missed deadlines", "%", [100.0 * run.missed], *few),
        Result.of(f"{name}: jitter of the ticks", "us", 1e6 * run.run.jitter),
        Result.of(f"{name}: cores", "", [run.run.cores]),
        Result.of(f"{name}: resident memory", "MiB", [sum(run.run.memory.values())]),
        *_bare_results(name, run.bare),
        *(
            Result.of(f"{name}: missed for {cause}", "ticks", [float(count)])
            for cause, count in run.deadlines.causes.items()
        ),
    ]


def _bare_results(name: str, bare: BareLoop | None) -> list[Result]:
    if bare is None:
        return []
    return [Result.of(f"{name}: missed deadlines of a bare loop", "%", [100.0 * bare.missed])]


def measure_realtime(work: Workload) -> list[Result]:
    """Run at 500 Hz without load, in six processes and composed, as long as the scenario takes."""
    chosen = [LoadCase(RATES[0], composed) for composed in (False, True)]
    return results(list(run_cases(chosen, float(work.record.times[-1]))))
