# SPDX-License-Identifier: Apache-2.0
"""Measurements are summed up and compared with their goals."""

from __future__ import annotations

import json
import math

import pytest

from bench import BLOCKS, run_measurements
from bench.baselines.libraries import measure_solvers
from bench.hops import measure_hops
from bench.results import Goal, Result, to_json
from bench.workload import Workload


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
    results = list(run_measurements(Workload.prepare(ticks=20, repeats=1), BLOCKS))
    assert len(results) >= len(BLOCKS)
    for result in results:
        assert 0.0 <= result.median <= result.largest < math.inf and result.count
    residual = next(r for r in results if "residual" in r.name)
    assert residual.met
    assert {r.section for r in results} == {"function calls"}
    plain = json.loads(json.dumps(to_json(results), allow_nan=False))
    assert [r["name"] for r in plain["results"]] == [r.name for r in results]
    assert plain["machine"]["versions"]["numpy"]


def test_a_ratio_names_what_it_is_a_ratio_to() -> None:
    slow = Result.of("slow", "us", [30.0]).against(Result.of("fast", "us", [10.0]))
    assert (slow.ratio, slow.beside) == (3.0, "fast")


def test_other_solvers_agree_and_are_timed_in_turns() -> None:
    """Those that are installed; one that answers otherwise would be left out."""
    own, *others = measure_solvers(Workload.prepare(ticks=20, repeats=1))
    assert "(13), OSQP set up anew" in [other.name for other in others]
    assert all(other.beside == own.name and other.count == own.count for other in others)


def test_messages_go_to_another_process_and_back() -> None:
    floor, lean, ordinary = measure_hops(Workload.prepare(ticks=20, repeats=1))
    assert min(r.median for r in (floor, lean, ordinary)) > 0.0
    assert (floor.count, lean.beside, ordinary.beside) == (40, floor.name, lean.name)
