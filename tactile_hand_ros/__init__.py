# SPDX-License-Identifier: Apache-2.0
"""Hold and turn an unknown object with a tactile prosthetic hand, on ROS 2.

The names below are what users of the library need; each is loaded on first use.
`control` is what runs on a real hand and `simulation` what replaces one. `closed_loop` wires the
blocks in-process, `ros` and `nodes` by topics. `bag`, `run`, `verify` and `report` work on
recordings. docs/explanation/architecture.md shows the path of a tick, a slip and a recording.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # `as` makes a name public to type checkers.
    from tactile_hand_ros import sweep as sweep
    from tactile_hand_ros.closed_loop.loop import ClosedLoop as ClosedLoop
    from tactile_hand_ros.closed_loop.record import Record as Record
    from tactile_hand_ros.control.contact import Contacts as Contacts
    from tactile_hand_ros.control.contact import contact_frame as contact_frame
    from tactile_hand_ros.control.controller import Controller as Controller
    from tactile_hand_ros.control.laws import OptimalLaw as OptimalLaw
    from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer as ForceOptimizer
    from tactile_hand_ros.control.optimizer.force_optimizer import (
        ForceOptimizerConfig as ForceOptimizerConfig,
    )
    from tactile_hand_ros.control.slip.regulator import SlipRegulator as SlipRegulator
    from tactile_hand_ros.errors import TactileHandError as TactileHandError
    from tactile_hand_ros.front_door import simulate as simulate
    from tactile_hand_ros.hand.hand import Hand as Hand
    from tactile_hand_ros.report.page import write_report as write_report
    from tactile_hand_ros.run.metrics import Metrics as Metrics
    from tactile_hand_ros.run.metrics import metrics as metrics
    from tactile_hand_ros.run.run import Run as Run
    from tactile_hand_ros.scenario.scenario import Scenario as Scenario
    from tactile_hand_ros.scenario.scenario import load_scenario as load_scenario
    from tactile_hand_ros.simulation.plant import Plant as Plant
    from tactile_hand_ros.simulation.skin import TactileSensor as TactileSensor
    from tactile_hand_ros.verify.recompute import recompute as recompute

__version__ = "0.2.0"

_HOMES = {
    "ClosedLoop": "closed_loop.loop",
    "Contacts": "control.contact",
    "Controller": "control.controller",
    "ForceOptimizer": "control.optimizer.force_optimizer",
    "ForceOptimizerConfig": "control.optimizer.force_optimizer",
    "Hand": "hand.hand",
    "Metrics": "run.metrics",
    "OptimalLaw": "control.laws",
    "Plant": "simulation.plant",
    "Record": "closed_loop.record",
    "Run": "run.run",
    "Scenario": "scenario.scenario",
    "SlipRegulator": "control.slip.regulator",
    "TactileHandError": "errors",
    "TactileSensor": "simulation.skin",
    "contact_frame": "control.contact",
    "load_scenario": "scenario.scenario",
    "metrics": "run.metrics",
    "recompute": "verify.recompute",
    "simulate": "front_door",
    "write_report": "report.page",
}
__all__ = [*_HOMES, "sweep"]


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562): a node pays only for what it imports itself."""
    if name == "sweep":  # a package: `sweep.run`
        return importlib.import_module(f"{__name__}.sweep")
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names besides what is loaded already."""
    return sorted({*globals(), *__all__})
