# SPDX-License-Identifier: Apache-2.0
"""What is asked of each run of a sweep: named metrics, and functions of the user's own."""

from __future__ import annotations

import importlib
import math
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.explanation import did_you_mean
from tactile_hand_ros.control.grasp import required_friction
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.run.metrics import START_S, Metrics
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.sweep.engine import LOST, MISSED, REACHED

Measure = Callable[[Record, Scenario, Metrics], float]


def outcome(record: Record, metrics: Metrics) -> str:
    """Return what became of a run, one of `OUTCOMES`."""
    if np.isnan(record.true_positions[-1]).any():
        return LOST
    return REACHED if metrics.goal_reached else MISSED


def true_position_error(record: Record, scenario: Scenario, metrics: Metrics) -> float:
    """Return the final distance of the true contact centroid from p_d, m."""
    del scenario, metrics
    apart = record.desired_position[-1] - record.true_positions[-1].mean(axis=0)
    return float(np.linalg.norm(apart))


def friction_margin(record: Record, scenario: Scenario, metrics: Metrics) -> float:
    """Return the minimum 1 - beta / mu of any contact after the start, with the true forces and mu.

    It is 1 without tangential force and 0 for a contact that is about to slip.
    """
    del metrics
    friction = np.full(len(record), scenario.plant.object.friction)
    for change in sorted(scenario.plant.friction_changes, key=lambda change: change.start):
        friction[record.times > change.start] = change.friction
    touching = np.isfinite(record.true_positions[:, :, 0])
    touching &= (record.times >= START_S)[:, None]
    beta = np.where(touching, required_friction(record.true_forces), np.nan)
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # where nothing touches at all
        minimum = float(np.nanmin(1.0 - beta / friction[:, None]))
    return minimum if math.isfinite(minimum) else math.nan


def _of(name: str) -> Measure:
    return lambda record, scenario, metrics: float(getattr(metrics, name))


METRICS: Mapping[str, Mapping[str, Measure]] = {
    "outcome": {},
    "slip": {"max_slip_distance_m": _of("max_slip_distance_m")},
    "error": {
        "final_position_error_m": _of("final_position_error_m"),
        "final_true_position_error_m": true_position_error,
        "final_rotation_error_rad": _of("final_rotation_error_rad"),
    },
    "peak_force": {"peak_normal_force_N": _of("peak_normal_force_N")},
    "margin": {"least_friction_margin": friction_margin},
    "settling_time": {"settling_time_s": _of("settling_time_s")},
}
"""By the name on the command line, the columns that a metric gives."""


def measures(names: Sequence[str]) -> dict[str, Measure]:
    """Return the columns of some metrics, in their order.

    Args:
        names: Of `METRICS`, or ``module:function`` of a function that takes record and scenario and
            returns a number.

    Raises:
        ConfigurationError: If there is no such metric or function.
    """
    found: dict[str, Measure] = {}
    for name in names:
        if ":" in name:
            found[name.partition(":")[2]] = _own(name)
        elif name in METRICS:
            found |= METRICS[name]
        else:
            raise ConfigurationError(
                f"--metric is '{name}'{did_you_mean(name, METRICS)} Or give module:function of "
                "your own."
            )
    return found


def _own(name: str) -> Measure:
    """Return a function of the user's own, from where the command was called."""
    module, _, attribute = name.partition(":")
    sys.path.insert(0, "")
    try:
        function = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigurationError(
            f"--metric is '{name}' ({error}), expected module:function that can be imported here."
        ) from None
    finally:
        sys.path.remove("")
    return lambda record, scenario, metrics: float(function(record, scenario))
