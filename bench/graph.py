# SPDX-License-Identifier: Apache-2.0
"""Throughput, startup time and missed deadlines of the ROS graph."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.bare_loop import missed_by_bare_loop
from bench.processes import CapturedProcess, isolated_domain
from bench.result import Measurement
from bench.wire import rate
from bench.workload import Workload
from bench.written import written_calls
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.processes import executable_path
from tactile_hand_ros.scenario.scenario import NODES

PRIORITY = 50
_TIMEOUT = 600.0  # s, in addition to the simulated time
_TRY = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({PRIORITY}))"
_FINEST = 1000.0  # Hz; above this rate a tick is shorter than the default plant step
_BARE_FACTOR, _FEW = 2.0, 0.1  # target for missed ticks: multiple of a bare loop's, at least [%]


class BenchError(TactileHandError):
    """A measured run that did not finish."""


def run_graph(seconds: float, *options: str) -> dict[str, Any]:
    """Run the orchestrator for a simulated time [s]; return its summary and the time in `wall_s`.

    Raises:
        BenchError: If the run did not finish.
    """
    fixed = ["--quiet", "--no-report", "--duration", str(seconds)]
    command = [executable_path("orchestrator")]
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        with CapturedProcess([*command, *fixed, "--out", folder, *options]) as orchestrator:
            code, said = orchestrator.wait(_TIMEOUT + seconds), orchestrator.stderr
        wall = time.perf_counter() - began
        file = Path(folder) / "latest" / "summary.json"
        summary: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.is_file() else {}
        if code not in (0, 1) or not ("--no-record" in options or summary.get("recording")):
            why = "; ".join(summary.get("reasons", [])) or said
            raise BenchError(f"a measured run exited with code {code}: {why}")
    return {**summary, "wall_s": wall}


def measure_lockstep(work: Workload) -> list[Measurement]:
    """Measure recorded lockstep runs, composed and in six processes, and their upper bounds.

    The bound of composed nodes is the in-process loop that writes the same bag. The bound of six
    processes is their message passing without computation. The four runs are interleaved.
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
        Measurement("in-process, writing the same bag", "ticks/s", written),
        Measurement("composed, lockstep, recording", "ticks/s", composed),
        Measurement(
            "  relative to in-process with the bag", "", _over(composed, written), minimum=0.75
        ),
        Measurement("message passing of six processes alone, recorded", "ticks/s", wire),
        Measurement("six processes, lockstep, recording", "ticks/s", apart),
        Measurement("  relative to message passing alone", "", _over(apart, wire), minimum=0.6),
        Measurement("start to first tick, composed", "s", _starts(one), maximum=2.0),
        Measurement("start to first tick, six processes", "s", _starts(six), maximum=3.0),
    ]


def _speeds(runs: list[dict[str, Any]]) -> list[float]:
    return [float(run["recording"]["ticks_per_second"]) for run in runs]


def _starts(runs: list[dict[str, Any]]) -> list[float]:
    return [float(run["start_to_first_tick_s"]) for run in runs]


def _over(values: list[float], limits: list[float]) -> list[float]:
    return [value / limit for value, limit in zip(values, limits, strict=True)]


def measure_short_run(work: Workload) -> list[Measurement]:
    """Measure the total time of a minimal run, from the command to its end."""
    options = ("--composed", "--no-record")
    walls = [float(run_graph(0.05, *options)["wall_s"]) for _ in range(work.repeats)]
    return [
        Measurement("run paper --duration 0.05 --composed --no-record", "s", walls, maximum=3.0)
    ]


def measure_real_time(work: Workload) -> list[Measurement]:
    """Measure missed deadlines of recorded composed nodes and of a bare loop, at each rate.

    Repeat under SCHED_FIFO if the machine permits it.
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
            loop = Measurement(f"bare loop, {where}: missed", "%", bare)
            allowed = max(_FEW, _BARE_FACTOR * loop.marks[0])
            found += [loop, Measurement(f"composed, {where}: missed", "%", missed, maximum=allowed)]
    return found


def real_time_options(hertz: float, priority: int) -> list[str]:
    """Return the orchestrator's options for a rate, with a plant step of at most one tick."""
    words = ["--composed", "--pacing", "realtime", "--set", f"plant.rate={hertz:g}"]
    if hertz > _FINEST:
        words += ["--set", f"plant.time_step={1.0 / hertz:.12g}"]
    return words + (["--priority", str(priority)] if priority else [])


def may_use_fifo() -> bool:
    """Return whether processes may use SCHED_FIFO here."""
    return subprocess.run([sys.executable, "-c", _TRY], capture_output=True).returncode == 0
