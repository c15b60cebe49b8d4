# SPDX-License-Identifier: Apache-2.0
"""The robustness map: each error changes its scenario, and the map counts what came of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies import robustness
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.sweep.engine import Point
from tactile_hand_ros.sweep.table import Store


@pytest.mark.parametrize("error", robustness.ERRORS, ids=lambda error: error.name)
def test_an_error_of_the_map_changes_its_scenario(error: robustness.Error) -> None:
    def changed(rank: int) -> str:
        values = {"rank": rank, "error": error.name, "scenario": "slippery"}
        return robustness.scenario_of(Point(0, 7, values)).model_dump_json()

    right = load_scenario("slippery", {"seed": 7}).model_dump_json()
    assert len({right, *(changed(rank) for rank in range(3))}) == 4


def test_the_map_is_drawn_from_its_table(tmp_path: Path) -> None:
    names = ("paper", "pinch")
    store_rows = []
    study = robustness.study_of(names, 0)
    for point in map(study.point, range(len(study.fractions))):
        came = ("reached", "missed", "lost")[point.values["rank"]]
        store_rows.append({"run": point.index, **point.values, "outcome": came})
    kept = Store(tmp_path, {"scenario": str, "error": str, "rank": int, "outcome": str}, {})
    kept.begin({})
    for row in store_rows:
        kept.add(row)
    kept.finish()
    assert robustness.figure(tmp_path) is not None
    rows = robustness.rows_of(tmp_path)
    assert rows[0] == ["links longer, 1 %", "2", "0", "0", "0"]
    assert rows[2] == ["links longer, 10 %", "0", "0", "2", "0"]
