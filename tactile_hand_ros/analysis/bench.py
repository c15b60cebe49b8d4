# SPDX-License-Identifier: Apache-2.0
"""Measurements of speed: a list of functions, each of which gives one or more results."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.analysis import tables
from tactile_hand_ros.analysis.metrics import json_ready
from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.record import Record
from tactile_hand_ros.core.scenario import Scenario, load_scenario

Array = NDArray[np.float64]

SCENARIO = "paper"


@dataclass(frozen=True)
class Goal:
    """A bound on one statistic of a measurement.

    Attributes:
        statistic: ``median``, ``p99`` or ``largest``.
        at_most: Upper bound; None for none.
        at_least: Lower bound; None for none.
    """

    statistic: str
    at_most: float | None = None
    at_least: float | None = None

    def met(self, result: Result) -> bool:
        """Return whether a result meets it."""
        value: float = getattr(result, self.statistic)
        over = self.at_most is None or value <= self.at_most
        return over and (self.at_least is None or value >= self.at_least)

    def __str__(self) -> str:
        """Return it in words."""
        if self.at_most is not None:
            return f"{self.statistic} < {self.at_most:g}"
        return f"{self.statistic} > {self.at_least:g}"


@dataclass(frozen=True)
class Result:
    """Samples of one quantity, summed up.

    Attributes:
        name: What was measured.
        unit: Its unit.
        count: Number of samples.
        median: Median.
        p99: 99th percentile.
        largest: Largest sample.
        goals: What is asked of it.
    """

    name: str
    unit: str
    count: int
    median: float
    p99: float
    largest: float
    goals: tuple[Goal, ...] = ()

    @classmethod
    def of(cls, name: str, unit: str, samples: Sequence[float] | Array, *goals: Goal) -> Result:
        """Sum up samples."""
        median, p99, largest = (float(v) for v in np.percentile(samples, [50, 99, 100]))
        return cls(name, unit, len(samples), median, p99, largest, goals)

    @property
    def met(self) -> bool | None:
        """Whether all goals are met; None without goals."""
        return all(goal.met(self) for goal in self.goals) if self.goals else None


@dataclass(frozen=True)
class Workload:
    """What the measurements work on, prepared once, with everything compiled and warm.

    Attributes:
        scenario: The scenario.
        record: A run of it, from which inputs are taken.
        repeats: How often whole runs are repeated.
    """

    scenario: Scenario
    record: Record
    repeats: int

    @classmethod
    def prepare(cls, ticks: int | None = None, repeats: int = 3) -> Workload:
        """Run the scenario once.

        Args:
            ticks: Number of ticks, that of the scenario by default.
            repeats: How often whole runs are repeated.
        """
        scenario = load_scenario(SCENARIO)
        return cls(scenario, ClosedLoop(scenario).run(ticks), repeats)


def measure_optimizer(work: Workload) -> list[Result]:
    """Solve (13) for the contacts of a run, tick by tick as the node does."""
    record, optimizer = work.record, ClosedLoop(work.scenario).optimizer
    grasps = [
        Contacts.from_poses(*pair)
        for pair in zip(record.contact_positions, record.contact_quaternions, strict=True)
    ]
    seconds, residuals = np.empty(len(grasps)), np.empty(len(grasps))
    for i, contacts in enumerate(grasps):
        start = time.perf_counter()
        solved = optimizer.solve(contacts)
        seconds[i], residuals[i] = time.perf_counter() - start, solved.residual
    return [
        Result.of(
            "(13), whole call", "us", 1e6 * seconds, Goal("median", 60.0), Goal("p99", 150.0)
        ),
        Result.of("(13), residual", "", residuals, Goal("largest", 1e-9)),
    ]


def measure_controller(work: Workload) -> list[Result]:
    """Answer the ticks of a run."""
    record, controller = work.record, ClosedLoop(work.scenario).controller
    seconds = np.empty(len(record))
    for i in range(len(record)):
        contacts = Contacts.from_poses(record.contact_positions[i], record.contact_quaternions[i])
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
    return [Result.of("controller, one tick", "us", 1e6 * seconds)]


def measure_plant(work: Workload) -> list[Result]:
    """Move hand and object by the commands of a run."""
    plant = ClosedLoop(work.scenario).plant
    seconds = np.empty(len(work.record))
    for i, torque in enumerate(work.record.command):
        start = time.perf_counter()
        plant.advance(torque)
        seconds[i] = time.perf_counter() - start
    config = work.scenario.plant
    name = f"plant, one step of {1e3 * config.time_step:g} ms"
    return [Result.of(name, "us", 1e6 * seconds / config.steps_per_tick)]


def measure_closed_loop(work: Workload) -> list[Result]:
    """Run the whole loop by function calls."""
    ticks, simulated = len(work.record), work.record.times[-1]
    speeds = []
    for _ in range(work.repeats):
        loop = ClosedLoop(work.scenario)
        start = time.perf_counter()
        loop.run(ticks)
        speeds.append(simulated / (time.perf_counter() - start))
    goal = Goal("median", at_least=5.0)
    return [Result.of("closed loop, times real time", "x", speeds, goal)]


Measurement = Callable[[Workload], list[Result]]

MEASUREMENTS: tuple[Measurement, ...] = (
    measure_optimizer,
    measure_controller,
    measure_plant,
    measure_closed_loop,
)
"""All measurements, in the order of the table."""


def run_measurements(
    work: Workload, measurements: Sequence[Measurement] = MEASUREMENTS
) -> Iterator[Result]:
    """Take all measurements, one after the other so that they do not disturb each other."""
    for measurement in measurements:
        yield from measurement(work)


COLUMNS = ("measurement", "unit", "median", "p99", "largest", "samples", "goal", "met")


def rows(results: Sequence[Result]) -> list[list[str]]:
    """Return results as text, columns as in `COLUMNS`."""
    words = {True: "yes", False: "no", None: ""}
    return [
        [
            r.name,
            r.unit,
            *(tables.number(value) for value in (r.median, r.p99, r.largest)),
            str(r.count),
            ", ".join(map(str, r.goals)),
            words[r.met],
        ]
        for r in results
    ]


def to_json(results: Sequence[Result]) -> dict[str, Any]:
    """Return results and machine as plain data."""
    content: dict[str, Any] = json_ready(
        {
            "machine": {
                "cpus": os.cpu_count(),
                "system": platform.platform(),
                "versions": versions(),
            },
            "results": [{**asdict(r), "met": r.met} for r in results],
        }
    )
    return content
