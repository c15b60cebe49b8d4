# SPDX-License-Identifier: Apache-2.0
"""How fast the ROS graph is: real runs of the orchestrator, judged by their bags."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
import psutil

from bench.results import Goal, Result
from bench.runs import GraphRun, run_graph
from bench.wire import rate
from bench.workload import Workload
from bench.written import written_calls
from tactile_hand_ros.ros.domains import isolated_domain
from tactile_hand_ros.ros.node import CALM_AFTER
from tactile_hand_ros.ros.processes import start_executable, wait_until
from tactile_hand_ros.scenario.scenario import NODES

_IDLE_SECONDS = 10.0
_TIMEOUT = 600.0  # s


def measure_graph(work: Workload) -> list[Result]:
    """Run the scenario in lockstep in six processes and in one, and their limits, turn by turn.

    The limit of processes is that of their messages, the limit of one process is the loop by
    function calls that writes the same bag.
    """
    seconds, ticks = float(work.record.times[-1]), len(work.record)
    six, single, speeds = [], [], []
    shares: list[float] = []
    calls: list[float] = []
    for _ in range(work.repeats):
        six.append(run_graph(seconds, load=True))
        speeds.append(six[-1].summary["recording"]["messages"] / six[-1].load_time)
        single.append(run_graph(seconds, "--composed"))
        limit = rate(NODES, ticks, recorded=True)
        shares.append(_ticks_per_second(six[-1]) / limit)
        calls.append(_ticks_per_second(single[-1]) / written_calls(work.scenario, ticks))
    separate = _results(six, "six processes", start=Goal("median", at_most=2.0))
    many = Goal("median", at_least=2500.0)
    composed = _results(single, "composed", many, start=Goal("median", at_most=1.2))
    pairs = zip(composed, separate, strict=True)
    return [
        *separate,
        *(one.against(other) if other.median else one for one, other in pairs),
        Result.of(
            "six processes, share of the wire's limit", "", shares, Goal("median", at_least=0.8)
        ),
        Result.of(
            "composed, share of function calls that write the same bag",
            "",
            calls,
            Goal("median", at_least=0.6),
        ),
        Result.of("bag loading, to arrays", "messages/s", speeds),
    ]


def measure_idle(work: Workload) -> list[Result]:
    """Let the nodes wait for the first tick."""
    with isolated_domain(), ExitStack() as stack:
        nodes = []
        for name in NODES:
            extra = ("-p", "autostart:=false") if name == "plant" else ()
            process = start_executable(name, "--ros-args", *extra)
            nodes.append(psutil.Process(stack.enter_context(process).pid))
        # Loaded is who has used little of a core for a while.
        wait_until(
            lambda: max(node.cpu_percent(0.5) for node in nodes) < 5.0, _TIMEOUT, "idle nodes"
        )
        psutil.cpu_percent(2.0 * CALM_AFTER)  # only now they look at the graph less often
        before = [sum(node.cpu_times()[:2]) for node in nodes]
        psutil.cpu_percent(_IDLE_SECONDS)
        used = [sum(node.cpu_times()[:2]) - b for node, b in zip(nodes, before, strict=True)]
        memory = [node.memory_info().rss / 2**20 for node in nodes]
        private = [node.memory_full_info().uss / 2**20 for node in nodes]
    shares = [100.0 * seconds / _IDLE_SECONDS for seconds in used]
    return [
        Result.of("idle node, share of a core", "%", shares, Goal("largest", at_most=1.0)),
        *(
            Result.of(f"resident memory, {name}", "MiB", [all_of_it])
            for name, all_of_it in zip(NODES, memory, strict=True)
        ),
        Result.of("memory that no other process shares, all nodes", "MiB", [sum(private)]),
    ]


def _ticks_per_second(run: GraphRun) -> float:
    return float(run.summary["recording"]["ticks_per_second"])


def _results(runs: Sequence[GraphRun], where: str, *many: Goal, start: Goal) -> list[Result]:
    def over(place: str, key: str) -> list[float]:
        return [run.summary[place][key] for run in runs]

    record = "recording"
    none = Goal("largest", at_most=0.0)
    ages = 1e6 * np.concatenate([run.ages for run in runs])
    return [
        Result.of(f"lockstep, {where}", "ticks/s", over(record, "ticks_per_second"), *many),
        Result.of(f"tick to command, {where}", "us", ages),
        Result.of(
            f"start to first tick, {where}",
            "s",
            over("startup_s", "first_tick_answered"),
            start,
        ),
        Result.of(f"messages lost, {where}", "", over(record, "lost_messages"), none),
    ]
