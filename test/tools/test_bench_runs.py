# SPDX-License-Identifier: Apache-2.0
"""Measured runs are real runs: the plant's counts, and memory and time of every process."""

from __future__ import annotations

import numpy as np
import pytest

from bench.realtime.cases import LOADED, LoadCase, run_load_case
from bench.runs import PROCESSES, BenchError, run_graph
from bench.wire import each_tick, rate
from bench.written import written_calls
from tactile_hand_ros.scenario.scenario import NODES, load_scenario


def test_a_real_time_run_under_load_is_counted_by_the_plant() -> None:
    run = run_load_case(LoadCase(100.0, True, LOADED), 1.0)
    assert run.deadlines.due >= 100
    assert run.bare is not None and run.bare.ticks >= 99
    assert 0.0 <= run.missed <= 1.0
    assert len(run.run.ages) > 1 and np.isfinite(run.run.ages).all() and run.run.ages.min() > 0.0
    assert np.isfinite(run.run.jitter).all()
    assert set(run.run.memory) == {"composed", "recorder"}
    assert min(run.run.memory.values()) > 1.0


def test_six_processes_are_told_apart() -> None:
    run = run_graph(0.2)
    assert set(run.memory) == set(PROCESSES) - {"composed"}
    assert run.plant["finished"] == "True"


def test_a_run_that_is_refused_is_an_error_with_its_reason() -> None:
    with pytest.raises(BenchError, match="no_such"):
        run_graph(0.2, "--set", "plant.no_such=1")


def test_ticks_go_round_by_messages_alone() -> None:
    """Between two processes, and among the nodes of each."""
    assert rate((",".join(NODES[:2]), ",".join(NODES[2:])), 20, recorded=False) > 0.0


def test_the_wire_carries_what_a_tick_does() -> None:
    wiring = each_tick()
    assert (len(wiring), sum(len(link.subscribers) for link in wiring)) == (19, 17)


def test_function_calls_can_write_a_bag() -> None:
    assert written_calls(load_scenario("paper"), 20) > 0.0
