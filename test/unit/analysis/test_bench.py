# SPDX-License-Identifier: Apache-2.0
"""Measurements are summed up and compared with their goals."""

from __future__ import annotations

import json
import math

import pytest

from tactile_hand_ros.analysis.bench import (
    COLUMNS,
    MEASUREMENTS,
    Goal,
    Result,
    Workload,
    rows,
    run_measurements,
    to_json,
)


def test_samples_are_summed_up() -> None:
    result = Result.of("speed", "us", list(range(101)))
    assert (result.median, result.p99, result.largest, result.count) == (50.0, 99.0, 100.0, 101)
    assert result.met is None


@pytest.mark.parametrize(
    ("goals", "met"),
    [
        ((Goal("median", at_most=50.0),), True),
        ((Goal("median", at_most=49.0),), False),
        ((Goal("median", at_most=60.0), Goal("p99", at_most=98.0)), False),
        ((Goal("median", at_least=50.0),), True),
        ((Goal("largest", at_least=101.0),), False),
    ],
)
def test_goals(goals: tuple[Goal, ...], met: bool) -> None:
    assert Result.of("speed", "us", list(range(101)), *goals).met is met


def test_unknown_samples_meet_no_goal() -> None:
    assert Result.of("residual", "", [math.nan], Goal("largest", at_most=1.0)).met is False


def test_every_measurement_gives_numbers() -> None:
    results = list(run_measurements(Workload.prepare(ticks=20, repeats=1)))
    assert len(results) >= len(MEASUREMENTS)
    for result in results:
        assert 0.0 <= result.median <= result.largest < math.inf and result.count
    residual = next(r for r in results if "residual" in r.name)
    assert residual.met
    assert all(len(row) == len(COLUMNS) for row in rows(results))
    plain = json.loads(json.dumps(to_json(results), allow_nan=False))
    assert [r["name"] for r in plain["results"]] == [r.name for r in results]
    assert plain["machine"]["versions"]["numpy"]
