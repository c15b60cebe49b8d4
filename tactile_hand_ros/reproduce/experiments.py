# SPDX-License-Identifier: Apache-2.0
"""The runs that the paper's claims are judged by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

LAYOUTS = ("three_faces", "pinch")


EXPERIMENTS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "optimal": ("paper", {}),
    "nominal": ("paper_nominal_weights", {}),
    "firm": ("paper", {"slip_regulator.grasp_force": 20.0}),
    "contact": ("contact_law", {}),
    "kawamura": ("kawamura", {}),
    "hold_optimal": ("paper", {"targets": []}),
    "hold_contact": ("contact_law", {"targets": []}),
    "hold_kawamura": ("kawamura", {"targets": []}),
}
"""Scenario and other values by dotted key: the paper's experiment under (14), with W = I, with
twice the grasp force, under (10) and (8); and each law that holds the object where it is."""


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
    name, others = EXPERIMENTS[key]
    changes = {"layout": layout, **others}
    if duration is not None:
        changes["duration"] = duration
    options = {"layout": "--layout", "duration": "--duration"}
    return load_scenario(name, changes, options)
