# SPDX-License-Identifier: Apache-2.0
"""How fast the ROS graph is, how long it takes to start, and what it misses in real time."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from bench.bare_loop import missed_by_bare_loop
from bench.result import Result
from bench.runs import run_graph
from bench.wire import rate
from bench.workload import Workload
from bench.written import written_calls
from tactile_hand_ros.scenario.scenario import NODES

PRIORITY = 50
_TRY = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"
_FINEST = 1000.0  # Hz: beyond this rate a tick is shorter than the ordinary step of the plant
_BARE_FACTOR, _FEW = 2.0, 0.1  # of what a bare loop misses, and %: what may be missed


def measure_lockstep(work: Workload) -> list[Result]:
    """Run the scenario in lockstep, recorded, composed and in six processes, and their limits.

    The limit of composed nodes is the in-process loop that writes the same bag; that of six
    processes is what their messages allow without computation. All four take turns.
    """
    seconds, ticks = float(work.record.times[-1]), len(work.record)
    one, six, written, wire = [], [], [], []
    for _ in range(work.repeats):
        written.append(written_calls(work.scenario, ticks))
        one.append(run_graph(seconds, "--composed"))
        wire.append(rate(NODES, ticks, recorded=True))
        six.append(run_graph(seconds, "--processes"))
    composed, apart = _speeds(one), _speeds(six)
    return [
        Result("in-process, writing the same bag", "ticks/s", written),
        Result("composed, lockstep, recording", "ticks/s", composed),
        Result(
            "  of the loop that writes the same bag", "", _over(composed, written), minimum=0.75
        ),
        Result("messages of six processes alone, recorded", "ticks/s", wire),
        Result("six processes, lockstep, recording", "ticks/s", apart),
        Result("  of the wire's limit", "", _over(apart, wire), minimum=0.6),
        Result("start to first tick, composed", "s", _starts(one), maximum=2.0),
        Result("start to first tick, six processes", "s", _starts(six), maximum=3.0),
    ]


def _speeds(runs: list[dict[str, Any]]) -> list[float]:
    return [float(run["recording"]["ticks_per_second"]) for run in runs]


def _starts(runs: list[dict[str, Any]]) -> list[float]:
    return [float(run["start_to_first_tick_s"]) for run in runs]


def _over(values: list[float], limits: list[float]) -> list[float]:
    return [value / limit for value, limit in zip(values, limits, strict=True)]


def measure_short_run(work: Workload) -> list[Result]:
    """Take the time of a run that does next to nothing, from the command to its end."""
    options = ("--composed", "--no-record")
    walls = [float(run_graph(0.05, *options)["wall_s"]) for _ in range(work.repeats)]
    return [Result("run paper --duration 0.05 --composed --no-record", "s", walls, maximum=3.0)]


def measure_real_time(work: Workload) -> list[Result]:
    """Count missed deadlines composed, recording, beside a bare loop, at each rate.

    Also under SCHED_FIFO where this machine permits it.
    """
    found = []
    for priority in (0, PRIORITY) if may_use_fifo() else (0,):
        for hertz in work.rates:
            bare, missed = [], []
            for _ in range(work.repeats):
                bare.append(100.0 * missed_by_bare_loop(hertz, 0.25 * work.seconds, priority))
                run = run_graph(work.seconds, *real_time_options(hertz, priority))
                missed.append(100.0 * float(run["real_time"]["missed_fraction"]))
            where = f"{hertz:g} Hz{', SCHED_FIFO' if priority else ''}"
            loop = Result(f"bare loop, {where}: missed", "%", bare)
            allowed = max(_FEW, _BARE_FACTOR * loop.marks[0])
            found += [loop, Result(f"composed, {where}: missed", "%", missed, maximum=allowed)]
    return found


def real_time_options(hertz: float, priority: int) -> list[str]:
    """Return the orchestrator's options for a rate, with plant steps that are short enough."""
    words = ["--composed", "--pacing", "realtime", "--set", f"plant.rate={hertz:g}"]
    if hertz > _FINEST:
        words += ["--set", f"plant.time_step={1.0 / hertz:.12g}"]
    return words + (["--priority", str(priority)] if priority else [])


def may_use_fifo() -> bool:
    """Return whether processes may use SCHED_FIFO here."""
    return subprocess.run([sys.executable, "-c", _TRY], capture_output=True).returncode == 0
