# SPDX-License-Identifier: Apache-2.0
"""The entry point for scripts and notebooks: run a scenario, get arrays, metrics and a report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.own_law import known_law
from tactile_hand_ros.report.page import Result
from tactile_hand_ros.scenario.scenario import load_scenario


def simulate(
    scenario: str = "paper",
    changes: Mapping[str, Any] | None = None,
    *,
    law: Any = None,
) -> Result:
    """Run a scenario in-process, without ROS.

    Args:
        scenario: Name of a scenario, or path of a YAML file.
        changes: New values by dotted key, such as ``{"plant.object.mass": 0.2}``.
        law: The control law: a class such as your own subclass of `OptimalLaw`, or a name.

    Returns:
        The run, with the same interface as `Run`: ``record``, ``metrics``, ``events``,
        ``to_pandas()``, ``plot()`` and ``report()``.

    Raises:
        TactileHandError: If a key or value is wrong, or the scenario cannot work.

    Example:
        >>> run = simulate("paper", {"duration": 0.1, "targets": []})
        >>> len(run.record), run.metrics.contacts_lost_ticks
        (51, 0)
    """
    changes = dict(changes or {})
    if isinstance(law, str):
        changes["law"] = law
    chosen = load_scenario(scenario, changes)
    if law is not None and not isinstance(law, str):
        controller = chosen.manipulation_controller
        known = controller.law.model_copy(update={"name": known_law(law), "folder": ""})
        controller = controller.model_copy(update={"law": known})
        chosen = chosen.model_copy(update={"manipulation_controller": controller})
    return Result(ClosedLoop(chosen).run(), chosen)
