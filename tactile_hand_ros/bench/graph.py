# SPDX-License-Identifier: Apache-2.0
"""How fast the ROS graph is: real runs of the orchestrator, judged by their bags."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil

from tactile_hand_ros.analysis.run import Run
from tactile_hand_ros.bench.results import Goal, Result
from tactile_hand_ros.bench.workload import Workload
from tactile_hand_ros.core.errors import TactileHandError
from tactile_hand_ros.core.scenario import NODES
from tactile_hand_ros.ros.testing import isolated_domain, start_executable, wait_until

_IDLE_SECONDS = 3.0
_TIMEOUT = 600.0  # s


class BenchError(TactileHandError):
    """A run that was to be measured did not come to its end."""


def measure_graph(work: Workload) -> list[Result]:
    """Run the scenario in lockstep in six processes and in two, turn by turn, then in real time."""
    seconds = float(work.record.times[-1])
    five, single = [], []
    for _ in range(work.repeats):
        five.append(_run(seconds))
        single.append(_run(seconds, "--composed"))
    fast = Goal("median", at_least=300.0)
    separate = _results(five, "five processes", fast, Goal("median", at_most=5.0))
    composed = _results(single, "composed", None, None)
    pairs = zip(composed, separate, strict=True)
    return [
        *separate,
        *(one.against(other) if other.median else one for one, other in pairs),
        *_realtime(_run(seconds, "--pacing", "realtime")),
    ]


def measure_idle(work: Workload) -> list[Result]:
    """Let the nodes wait for the first tick."""
    with isolated_domain(), ExitStack() as stack:
        nodes = []
        for name in NODES:
            extra = ("-p", "autostart:=false") if name == "plant" else ()
            process = start_executable(name, "--ros-args", *extra)
            nodes.append(psutil.Process(stack.enter_context(process).pid))
        # Loaded is who has used less than a hundredth of a core for a while.
        wait_until(
            lambda: max(node.cpu_percent(0.5) for node in nodes) < 5.0, _TIMEOUT, "idle nodes"
        )
        before = [sum(node.cpu_times()[:2]) for node in nodes]
        psutil.cpu_percent(_IDLE_SECONDS)
        used = [sum(node.cpu_times()[:2]) - b for node, b in zip(nodes, before, strict=True)]
        memory = [node.memory_info().rss / 2**20 for node in nodes]
    shares = [100.0 * seconds / _IDLE_SECONDS for seconds in used]
    return [
        Result.of("idle node, share of a core", "%", shares, Goal("largest", at_most=1.0)),
        Result.of("idle node, resident memory", "MiB", memory),
    ]


def _run(seconds: float, *options: str) -> dict[str, Any]:
    """Run the orchestrator and return its summary, with the plant's last diagnostics."""
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tactile_hand_ros.ros.executables", "orchestrator"]
        fixed = ["--quiet", "--no-report", "--out", folder, "--duration", str(seconds)]
        ended = subprocess.run(
            [*command, *fixed, *options], capture_output=True, text=True, timeout=_TIMEOUT
        )
        path = Path(folder) / "latest"
        file = path / "summary.json"
        if ended.returncode not in (0, 1) or not file.is_file():
            raise BenchError(f"a run to be measured ended with {ended.returncode}: {ended.stderr}")
        summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        said = [each for each in Run(path).diagnostics if each.name == "/plant"]
        summary["plant"] = said[-1].values if said else {}
        return summary


def _results(
    runs: Sequence[dict[str, Any]], where: str, rate: Goal | None, start: Goal | None
) -> list[Result]:
    def over(place: str, key: str, factor: float = 1.0) -> list[float]:
        return [factor * run[place][key] for run in runs]

    def goals(*given: Goal | None) -> tuple[Goal, ...]:
        return tuple(goal for goal in given if goal is not None)

    record = "recording"
    none = Goal("largest", at_most=0.0)
    latency = "command_latency_median_s"
    return [
        Result.of(f"lockstep, {where}", "ticks/s", over(record, "ticks_per_second"), *goals(rate)),
        Result.of(f"tick to command, {where}", "us", over(record, latency, 1e6)),
        Result.of(
            f"start to first tick, {where}",
            "s",
            over("startup_s", "first_tick_answered"),
            *goals(start),
        ),
        Result.of(f"messages lost, {where}", "", over(record, "lost_messages"), none),
    ]


def _realtime(run: dict[str, Any]) -> list[Result]:
    """Sum up a run at the pace of the wall clock, as plant and bag saw it."""
    record, plant = run["recording"], run["plant"]
    wanted = {
        "late commands": ("late_commands", 100.0 / run["metrics"]["ticks"], "%"),
        "jitter, p50": ("jitter_p50_us", 1.0, "us"),
        "jitter, p99": ("jitter_p99_us", 1.0, "us"),
    }
    found = [
        Result.of(f"real time, {name}", unit, [factor * float(plant[key])])
        for name, (key, factor, unit) in wanted.items()
        if key in plant
    ]
    return [
        Result.of(
            "real time, tick to command, p50", "us", [1e6 * record["command_latency_median_s"]]
        ),
        Result.of("real time, tick to command, p99", "us", [1e6 * record["command_latency_p99_s"]]),
        *found,
    ]
