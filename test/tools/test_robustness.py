# SPDX-License-Identifier: Apache-2.0
"""The robustness map: each error changes its scenario, and the map counts what came of it."""

from __future__ import annotations

import numpy as np
import pytest

from studies import robustness
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.sweep.engine import Point


@pytest.mark.parametrize("error", robustness.ERRORS, ids=lambda error: error.name)
def test_an_error_of_the_map_changes_its_scenario(error: robustness.Error) -> None:
    def changed(rank: int) -> str:
        values = {"rank": rank, "error": error.name, "scenario": "slippery"}
        return robustness.scenario_of(Point(0, 7, values)).model_dump_json()

    right = load_scenario("slippery", {"seed": 7}).model_dump_json()
    assert len({right, *(changed(rank) for rank in range(3))}) == 4


def test_the_map_is_drawn_from_its_table() -> None:
    study = robustness.study_of(("paper", "pinch"), 0)
    points = [study.point(index).values for index in range(len(study.fractions))]
    table = {name: np.array([point[name] for point in points]) for name in points[0]}
    table["outcome"] = np.array(["reached", "missed", "lost"])[table["rank"]]
    assert robustness.figure(table) is not None
    rows = robustness.rows_of(table)
    assert rows[0] == ["links longer, 1 %", "2", "0", "0", "0"]
    assert rows[2] == ["links longer, 10 %", "0", "0", "2", "0"]
