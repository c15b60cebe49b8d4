# SPDX-License-Identifier: Apache-2.0
"""How long the blocks of the loop take when they are called as functions."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from bench.results import Goal, Result
from bench.workload import SCENARIO, Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer
from tactile_hand_ros.scenario.scenario import Scenario, changed, load_scenario

Array = NDArray[np.float64]

_WARM = 50  # ticks
_TURNS = 3


def optimizer_times(work: Workload, solver: str = "exact") -> tuple[Array, Array]:
    """Solve (13) for the contacts of a run, tick by tick as the node does.

    Returns:
        Times [s] and residuals.
    """
    config = work.scenario.force_optimizer.changed({"solver": solver})
    optimizer = ForceOptimizer(config, work.record.forces.shape[1])
    grasps = work.grasps
    seconds, residuals = np.empty(len(grasps)), np.empty(len(grasps))
    for i, contacts in enumerate(grasps):
        start = time.perf_counter()
        solved = optimizer.solve(contacts)
        seconds[i], residuals[i] = time.perf_counter() - start, solved.residual
    return seconds, residuals


def controller_times(work: Workload) -> Array:
    """Answer the ticks of a run; return times [s]."""
    record, controller = work.record, ClosedLoop(work.scenario).controller
    seconds = np.empty(len(record))
    for i, contacts in enumerate(work.grasps):
        start = time.perf_counter()
        controller.step(
            int(record.stamps[i]),
            record.theta[i],
            record.rates[i],
            contacts,
            record.optimal_forces[i],
            float(record.grasp_force[i]),
        )
        seconds[i] = time.perf_counter() - start
    return seconds


def plant_times(work: Workload) -> Array:
    """Move hand and object by the commands of a run; return times of a step [s]."""
    plant = ClosedLoop(work.scenario).plant
    seconds = np.empty(len(work.record))
    for i, torque in enumerate(work.record.command):
        start = time.perf_counter()
        plant.advance(torque)
        seconds[i] = time.perf_counter() - start
    return seconds / work.scenario.plant.steps_per_tick


def measure_optimizer(work: Workload) -> list[Result]:
    """Measure (13) from the contacts on, with its checks and residuals, by both solvers."""
    goals = {"exact": (15.0, 50.0), "osqp": (45.0, 100.0)}
    results = []
    for solver, (median, p99) in goals.items():
        seconds, residuals = optimizer_times(work, solver)
        limits = Goal("median", median), Goal("p99", p99)
        results += [
            Result.of(f"(13), {solver}", "us", 1e6 * seconds, *limits),
            Result.of(f"(13), {solver}, residual", "", residuals, Goal("largest", 1e-9)),
        ]
    return results


def measure_controller(work: Workload) -> list[Result]:
    """Measure the controller's answer to a tick."""
    return [Result.of("controller, one tick", "us", 1e6 * controller_times(work))]


def measure_plant(work: Workload) -> list[Result]:
    """Measure a step of the plant."""
    name = f"plant, one step of {1e3 * work.scenario.plant.time_step:g} ms"
    return [Result.of(name, "us", 1e6 * plant_times(work))]


def measure_closed_loop(work: Workload) -> list[Result]:
    """Run the whole loop by function calls, at its own rate and at one plant step a tick."""
    scenario, ticks = work.scenario, len(work.record)
    single = changed(scenario, {"plant.rate": 1.0 / scenario.plant.time_step})
    rates = [[_loop_rate(each, ticks) for _ in range(work.repeats)] for each in (scenario, single)]
    speeds = [rate / scenario.plant.rate for rate in rates[0]]
    ten = Goal("median", at_least=10.0)
    many = Goal("median", at_least=10_000.0)
    return [
        Result.of("closed loop, times real time", "x", speeds, ten),
        Result.of("closed loop, one plant step a tick", "ticks/s", rates[1], many),
    ]


def function_calls(ticks: int = 300) -> float:
    """Return how many ticks a second the loop makes by function calls, one plant step each.

    The machine changes its speed from hour to hour: give this beside what else was measured.
    """
    scenario = load_scenario(SCENARIO, {"plant.rate": 1000.0})
    _loop_rate(scenario, _WARM)
    return float(np.median([_loop_rate(scenario, ticks) for _ in range(_TURNS)]))


def _loop_rate(scenario: Scenario, ticks: int) -> float:
    loop = ClosedLoop(scenario)
    start = time.perf_counter()
    loop.run(ticks)
    return ticks / (time.perf_counter() - start)
