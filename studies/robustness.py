# SPDX-License-Identifier: Apache-2.0
"""The robustness map: how far each scenario survives that the hand knows something wrongly.

`make study NAME=robustness` makes it. Each run has one error, of one size: of calibration, of
the skin, or of what the world is like.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import tactile_hand_ros
from tactile_hand_ros.report.style import PAGE, look, new_figure
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.sweep.engine import FAILED, LOST, MISSED, REACHED, Point, Study
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.sweep import measured
from tactile_hand_ros.sweep.table import Table, Tally, keep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURES = ("error", "slip")
COLORS = {REACHED: "#009E73", MISSED: "#E9C46A", LOST: "#D55E00", FAILED: "#444444"}
MEANINGS = {
    REACHED: "reaches its goal",
    MISSED: "holds the object, misses the goal",
    LOST: "loses a contact",
    FAILED: "cannot be run",
}


@dataclass(frozen=True)
class Error:
    """Something that the hand knows wrongly.

    Attributes:
        name: What it is.
        unit: Of its sizes.
        sizes: Small, medium, large.
        changes: Returns the values to change, from scenario, size and a random direction.
    """

    name: str
    unit: str
    sizes: tuple[float, float, float]
    changes: Callable[[Scenario, float, list[float]], Mapping[str, Any]]


def _turned(key: str) -> Callable[[Scenario, float, list[float]], Mapping[str, Any]]:
    return lambda _, size, axis: {key: [math.radians(size) * x for x in axis]}


def _scaled(key: str, sign: float) -> Callable[[Scenario, float, list[float]], Mapping[str, Any]]:
    return lambda _, size, axis: {key: 1.0 + 0.01 * sign * size}


def _heavier(scenario: Scenario, size: float, _: list[float]) -> Mapping[str, Any]:
    body, fraction = scenario.plant.object, 1.0 + 0.01 * size
    inertia = [fraction * x for x in body.inertia]
    return {"plant.object.mass": fraction * body.mass, "plant.object.inertia": inertia}


def _slipperier(scenario: Scenario, size: float, _: list[float]) -> Mapping[str, Any]:
    fraction = 1.0 - 0.01 * size
    changes = [
        {"start": change.start, "friction": fraction * change.friction}
        for change in scenario.plant.friction_changes
    ]
    friction = fraction * scenario.plant.object.friction
    return {"plant.object.friction": friction, "plant.friction_changes": changes}


def _later(scenario: Scenario, size: float, _: list[float]) -> Mapping[str, Any]:
    return {"tactile_sensor.latency": scenario.tactile_sensor.latency + 0.001 * size}


def _noisier(scenario: Scenario, size: float, _: list[float]) -> Mapping[str, Any]:
    noise = math.hypot(scenario.tactile_sensor.force_noise, 0.001 * size)
    return {"tactile_sensor.force_noise": noise}


ERRORS = (
    Error("links longer", "%", (1.0, 3.0, 10.0), _scaled("calibration.link_lengths", 1.0)),
    Error("links shorter", "%", (1.0, 3.0, 10.0), _scaled("calibration.link_lengths", -1.0)),
    Error("tips larger", "%", (1.0, 3.0, 10.0), _scaled("calibration.tip_radii", 1.0)),
    Error("skin turned", "deg", (1.0, 3.0, 10.0), _turned("calibration.skin_rotation")),
    Error("gravity turned", "deg", (1.0, 3.0, 10.0), _turned("calibration.gravity_rotation")),
    Error("latency", "ms", (2.0, 6.0, 20.0), _later),
    Error("force noise", "mN", (10.0, 30.0, 100.0), _noisier),
    Error("less friction", "%", (10.0, 30.0, 60.0), _slipperier),
    Error("more mass", "%", (10.0, 30.0, 100.0), _heavier),
)
_BY_NAME = {error.name: error for error in ERRORS}
_RANKS = (2, 1, 0)  # the largest errors first, so that an early look shows most


def run_one(point: Point) -> dict[str, Any]:
    """Run a scenario with one error and return what came of it."""
    error = _BY_NAME[point.values["error"]]
    size = {"size": error.sizes[point.values["rank"]], "unit": error.unit}
    return {**size, **measured(scenario_of(point), MEASURES)}


def scenario_of(point: Point) -> Scenario:
    """Return the scenario of a run; an error with a direction has that of the run's seed."""
    error = _BY_NAME[point.values["error"]]
    axis = np.random.default_rng(point.seed).standard_normal(3)
    axis = axis / np.linalg.norm(axis)
    base = _base(point.values["scenario"])
    changes = error.changes(base, error.sizes[point.values["rank"]], axis.tolist())
    return load_scenario(base.name, {**changes, "seed": point.seed})


@functools.cache
def _base(name: str) -> Scenario:
    return load_scenario(name)


def study_of(scenarios: tuple[str, ...], seed: int) -> Study:
    """Return the map of some scenarios as a study."""
    errors = Choice(tuple(_BY_NAME))
    space = {"rank": Choice(_RANKS), "error": errors, "scenario": Choice(scenarios)}
    return Study(space, "grid", run_one, seed=seed)


def run_map(
    scenarios: tuple[str, ...],
    folder: Path,
    seed: int = 0,
    watch: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Make all runs of the map that are not done yet, and write their table.

    Args:
        scenarios: Names.
        folder: Of the results.
        seed: Of noise and directions.
        watch: Called after each run.

    Raises:
        ConfigurationError: If there is no such scenario.
        StudyError: If the folder cannot be written.
    """
    for name in scenarios:
        _base(name)
    version = tactile_hand_ros.__version__
    description = {"version": version, "scenarios": list(scenarios), "seed": seed}
    return keep(study_of(scenarios, seed), folder, description, watch)


def figure(table: Table) -> Figure:
    """Draw what became of each scenario under each error of three sizes, from a map's table."""
    columns = [table[name].tolist() for name in ("scenario", "error", "rank", "outcome")]
    rows = list(dict.fromkeys(columns[0]))
    with look():
        made = new_figure(PAGE, 0.9 + 0.22 * len(rows))
        axes = made.subplots()
        for scenario, error, rank, came in zip(*columns, strict=True):
            x = list(_BY_NAME).index(error) + 0.28 * (rank - 1)
            y = rows.index(scenario)
            axes.barh(y, 0.27, 0.82, x - 0.135, color=COLORS[came], linewidth=0.0)
        labels = [f"{e.name}\n{', '.join(f'{s:g}' for s in e.sizes)} {e.unit}" for e in ERRORS]
        axes.set_xticks(range(len(ERRORS)), labels, fontsize=6.0)
        axes.xaxis.tick_top()
        axes.set_yticks(range(len(rows)), [name.replace("_", " ") for name in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlim(-0.5, len(ERRORS) - 0.5)
        axes.tick_params(length=0.0)
        axes.grid(False)
        for name, meaning in MEANINGS.items():
            axes.barh([math.nan], [0.0], color=COLORS[name], label=meaning)
        made.legend(loc="outside lower center", ncols=len(MEANINGS))
    return made


def rows_of(table: Table) -> list[list[str]]:
    """Return how many scenarios reach their goal, or hold the object, under each error."""
    rows = []
    for kind in ERRORS:
        for index, size in enumerate(kind.sizes):
            some = table["outcome"][(table["error"] == kind.name) & (table["rank"] == index)]
            counts = [str(int((some == name).sum())) for name in COLORS]
            rows.append([f"{kind.name}, {size:g} {kind.unit}", *counts])
    return rows


COLUMNS = ("error", *MEANINGS.values())
