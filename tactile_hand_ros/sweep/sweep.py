# SPDX-License-Identifier: Apache-2.0
"""A sweep: the study of a scenario over ranges of its parameters, and the metrics of its runs."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import leaves
from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.control.grasp import required_friction
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.own_law import take_law
from tactile_hand_ros.run.metrics import START_S, Metrics, metrics
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, plain
from tactile_hand_ros.sweep.engine import LOST, MISSED, REACHED, Point, Study
from tactile_hand_ros.sweep.space import Choice, parse_parameter

METRICS = (
    "max_slip_distance_m",
    "final_position_error_m",
    "final_true_position_error_m",
    "final_rotation_error_rad",
    "peak_normal_force_N",
    "least_friction_margin",
    "settling_time_s",
)
"""The metric columns of a sweep: those of `Metrics` and of this module."""


def outcome(record: Record, metrics: Metrics) -> str:
    """Return the outcome of a run, one of `OUTCOMES`."""
    if np.isnan(record.true_positions[-1]).any():
        return LOST
    return REACHED if metrics.goal_reached else MISSED


def friction_margin(record: Record, scenario: Scenario) -> float:
    """Return the minimum 1 - beta / mu of any contact after the start, with the true forces and mu.

    It is 1 without tangential force and 0 for a contact that is about to slip.
    """
    friction = np.full(len(record), scenario.plant.object.friction)
    for change in sorted(scenario.plant.friction_changes, key=lambda change: change.start):
        friction[record.stamps > round(1e9 * change.start)] = change.friction
    touching = np.isfinite(record.true_positions[:, :, 0])
    touching &= (record.times >= START_S)[:, None]
    beta = np.where(touching, required_friction(record.true_forces), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        margins = 1.0 - beta / friction[:, None]
    minimum = float(np.fmin.reduce(margins, axis=None, initial=math.nan))
    return minimum if math.isfinite(minimum) else math.nan


@dataclass(frozen=True)
class ScenarioRun:
    """Runs a point of a sweep on the scenario `base`; returns `METRICS` and outcome."""

    base: Scenario

    def __call__(self, point: Point) -> dict[str, Any]:
        """Run a point."""
        scenario = self.scenario_of(point)
        take_law(scenario.manipulation_controller.law)  # named by the user of the sweep
        record = ClosedLoop(scenario).run()
        found = metrics(record, scenario)
        # From p_d to the true contact centroid.
        apart = record.desired_position[-1] - record.true_positions[-1].mean(axis=0)
        numbers = {
            **vars(found),
            "final_true_position_error_m": float(np.linalg.norm(apart)),
            "least_friction_margin": friction_margin(record, scenario),
        }
        return {**{name: numbers[name] for name in METRICS}, "outcome": outcome(record, found)}

    def scenario_of(self, point: Point) -> Scenario:
        """Return the scenario of a run; raise ConfigurationError if a value is rejected."""
        return self.base.changed({"seed": point.seed, **point.values})


def make_sweep(
    scenario: str,
    over: Sequence[str],
    fixed: Mapping[str, Any],
    *,
    runs: int = 100,
    seed: int = 0,
) -> Study:
    """Return a sweep as a study; check both ends of every range and each value of a list.

    The arguments are those of `sweep.run`; `fixed` are its `changes`.

    Raises:
        ConfigurationError: If a name, path, range or value is invalid, or set twice.
    """
    base = load_scenario(scenario, fixed)
    if not over:
        raise ConfigurationError(
            "nothing is varied; give --over such as --over plant.object.mass=0.05..0.5."
        )
    whole = {path for path, field in leaves(Scenario).items() if field.annotation is int}
    parsed = [parse_parameter(each, whole) for each in over]
    for path, parameter in parsed:
        if [*fixed, *(name for name, _ in parsed)].count(path) > 1:
            raise ConfigurationError(f"{path} is given twice; give it once, by --over or by --set.")
        checked = [parameter.value(0.0), parameter.value(1.0)]
        if isinstance(parameter, Choice) and not isinstance(parameter.values, range):
            checked = [*parameter.values]
        for value in checked:
            base.changed({path: value})
    if "seed" in fixed:  # not those of the runs
        parsed.append(("seed", Choice((base.seed,))))
    return Study(dict(parsed), ScenarioRun(base), runs, seed, _description(base))


def _description(base: Scenario) -> dict[str, Any]:
    """Return what a sweep is continued with: the scenario, and the content of its own files."""
    files = [find_file("hand", base.hand), load_hand_config(base.hand).file]
    files += [Path(base.plant.object.mesh)] if base.plant.object.mesh else []
    law, _, is_own = base.manipulation_controller.law.name.partition(":")
    if is_own and getattr(sys.modules[law], "__file__", None):  # not of a notebook
        files.append(Path(str(sys.modules[law].__file__)))
    digests = {f"content of {each}": sha256(each.read_bytes()).hexdigest()[:16] for each in files}
    return {"scenario": plain(base), **digests}
