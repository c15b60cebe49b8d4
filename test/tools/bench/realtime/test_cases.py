# SPDX-License-Identifier: Apache-2.0
"""What real-time runs are asked for, and how what the plant counted is summed up and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.figures import realtime_figure
from bench.realtime.bare_loop import BareLoop
from bench.realtime.cases import (
    ALONE,
    FIRST,
    LOADED,
    LOADED_FIRST,
    RATES,
    LoadCase,
    RealtimeRun,
    cases,
    may_go_first,
    results,
    summed_up,
)
from bench.runs import GraphRun, Usage
from tactile_hand_ros.report.style import save
from tactile_hand_ros.ros.histogram import Histogram
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.run.recording import read_deadlines

USAGE = [Usage(float(t), {"plant": 0.5 * t, "recorder": 0.1 * t}, {"plant": 100.0}) for t in (0, 4)]


def counted(durations: list[float]) -> str:
    """Return what the plant would say of durations."""
    histogram = Histogram()
    for duration in durations:
        histogram.note(duration)
    return histogram.text()


def run_of(case: LoadCase, bare: float = 0.0, **said: str) -> RealtimeRun:
    """Return a run of which the plant reported something, beside a bare loop that missed some."""
    plant = {
        "late_commands": "1",
        "missed_ticks": "2",
        "lost_s": "0.004",
        "time_s": "2",
        "age_histogram_us": counted([5e-4] * 998 + [0.05] * 2),
        "jitter_histogram_us": counted([1e-5] * 1000),
        **said,
    }
    kept = read_deadlines(plant, case.rate, 2.0, 2.0)
    graph = GraphRun({"real_time": json_ready(kept.to_dict())}, plant, USAGE)
    return summed_up(case, graph, BareLoop(1000, bare, 1e-4))


def test_every_way_to_run_is_asked_for() -> None:
    found = cases(loaded=True)
    conditions = {ALONE, LOADED} | ({FIRST, LOADED_FIRST} if may_go_first() else set())
    assert {case.condition for case in found} == conditions
    assert len(found) == len(RATES) * 2 * len(conditions) == len({str(case) for case in found})
    assert {case.condition for case in cases()} == conditions - {LOADED, LOADED_FIRST}
    options = LoadCase(1000.0, True, LOADED_FIRST).options
    assert "--composed" in options and "plant.rate=1000" in options and "--priority" in options
    assert "--priority" not in LoadCase(1000.0, True, LOADED).options
    assert "--processes" in LoadCase(2000.0, False).options
    assert "plant.time_step=0.0005" in LoadCase(2000.0, False).options


def test_what_was_late_skipped_or_given_up_is_missed() -> None:
    run = run_of(LoadCase(500.0, False))
    assert run.deadlines.due == 1002
    assert run.missed == pytest.approx((1 + 2 + 2) / 1002)
    assert run.run.cores == pytest.approx(0.6)
    assert run.run.memory == {"plant": 100.0}


def test_a_plant_that_has_not_reported_meets_no_goal() -> None:
    kept = json_ready(read_deadlines({}, 500.0, 2.0, 2.0).to_dict())
    run = summed_up(LoadCase(500.0, True), GraphRun({"real_time": kept}, {}, []))
    age, missed, *_ = results([run])
    assert np.isnan(run.missed) and age.met is False and missed.met is False


def test_goals_are_for_one_process_and_allow_twice_what_a_bare_loop_misses() -> None:
    case = LoadCase(500.0, True)
    age, missed, *others = results([run_of(case)])
    assert age.median == pytest.approx(500.0, rel=0.06) and age.met
    assert age.p999 > 1000.0 and age.largest == pytest.approx(50_000.0, rel=0.06)
    assert (missed.met, [each.met for each in others]) == (False, [None] * len(others))
    assert results([run_of(case, bare=0.003)])[1].met
    assert all(each.met is None for each in results([run_of(LoadCase(500.0, False))]))


def test_the_figure_takes_what_there_is(tmp_path: Path) -> None:
    runs = [run_of(LoadCase(500.0, False)), run_of(LoadCase(1000.0, True, LOADED))]
    (file,) = save(realtime_figure(runs), tmp_path, "realtime", ("png",))
    assert file.stat().st_size > 1000
    save(realtime_figure(runs[:1]), tmp_path, "one", ("svg",))
    assert (tmp_path / "one.svg").exists()
