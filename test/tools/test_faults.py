# SPDX-License-Identifier: Apache-2.0
"""The fault campaign, the fuzzing of nodes and the soak on real nodes, each for some seconds."""

from __future__ import annotations

from pathlib import Path

from studies.faults.campaign import run_campaign
from studies.faults.space import Cell, Run
from studies.fuzz.fuzz import Report
from studies.fuzz.live import fuzz_nodes
from studies.soak import soak, soak_scenario

DEATHS = (("sensor", "stopped"), ("regulator", "off"))


def test_a_session_of_the_campaign_keeps_the_object() -> None:
    runs = [Run(Cell("lockstep", "at rest", *fault), 1) for fault in DEATHS]
    outcomes = list(run_campaign(runs))
    assert [o.error for o in outcomes] == ["", ""]
    assert not any(o.dropped for o in outcomes)
    assert outcomes[1].safe is not None and outcomes[1].recovered is not None
    assert all(o.moved < 0.003 and o.peak < 1.2 * o.limit for o in outcomes)


def test_a_long_run_lets_nothing_grow() -> None:
    seen = soak(soak_scenario(250.0, lockstep=True), 8.0, composed=True)
    assert seen.ticks > 200 and seen.is_held
    assert seen.growth(seen.descriptors) == 0 and seen.growth(seen.threads) == 0
    assert seen.slope(seen.memory) < 500e3 and seen.slope(seen.recorder) < 1e6


def test_running_nodes_survive_hostile_bytes(tmp_path: Path) -> None:
    report = Report(3)
    fuzz_nodes(report, 4.0, tmp_path)
    assert report.findings == [] and report.inputs["live"] > 200
    assert report.growth < 100 * 2**20
