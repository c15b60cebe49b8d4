# SPDX-License-Identifier: Apache-2.0
"""The runs that the paper's claims are judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

LAYOUTS = ("three_faces", "pinch")


@dataclass(frozen=True)
class Experiment:
    """A scenario with some values changed.

    Attributes:
        scenario: Name of the scenario.
        meaning: What it shows.
        changes: Values to change, by dotted key.
    """

    scenario: str
    meaning: str
    changes: Mapping[str, Any] = field(default_factory=dict)


EXPERIMENTS: Mapping[str, Experiment] = {
    "optimal": Experiment("paper", "law (14), the paper's experiment"),
    "nominal": Experiment("paper_nominal_weights", "law (14) with W = I"),
    "firm": Experiment(
        "paper", "law (14) with twice the grasp force", {"slip_regulator.grasp_force": 20.0}
    ),
    "contact": Experiment("contact_law", "law (10) on the same task"),
    "kawamura": Experiment("kawamura", "law (8) on the same task"),
    "hold_optimal": Experiment("paper", "law (14), held where it is", {"targets": []}),
    "hold_contact": Experiment("contact_law", "law (10), held where it is", {"targets": []}),
    "hold_kawamura": Experiment("kawamura", "law (8), held where it is", {"targets": []}),
}


class ExperimentRun(RunData):
    """A finished experiment."""

    scenario: Scenario


def run_experiment(key: str, layout: str, duration: float | None = None) -> ExperimentRun:
    """Run one experiment in-process.

    Args:
        key: Which of `EXPERIMENTS`.
        layout: Layout of the hand's fingers.
        duration: Simulated time in s instead of the scenario's.
    """
    scenario = scenario_of(key, layout, duration)
    return ExperimentRun(ClosedLoop(scenario).run(), scenario)


def scenario_of(key: str, layout: str, duration: float | None = None) -> Scenario:
    """Return the scenario of an experiment; arguments as for `run_experiment`.

    Raises:
        ConfigurationError: If a layout or duration cannot be used.
    """
    experiment = EXPERIMENTS[key]
    changes = {"layout": layout, **experiment.changes}
    if duration is not None:
        changes["duration"] = duration
    options = {"layout": "--layout", "duration": "--duration"}
    return load_scenario(experiment.scenario, changes, options)
