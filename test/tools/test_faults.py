# SPDX-License-Identifier: Apache-2.0
"""The fault campaign, the fuzzing of nodes and the soak on real nodes, each for some seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.faults.campaign import run_campaign
from studies.faults.space import Injection
from studies.fuzz import fuzz_nodes
from studies.soak import soak, soak_scenario
from tactile_hand_ros.sweep.table import read_table

DEATHS = (("sensor", "stopped"), ("regulator", "off"))


def test_a_session_of_the_campaign_keeps_the_object(tmp_path: Path) -> None:
    run_campaign([Injection("lockstep", "at rest", *fault, 1) for fault in DEATHS], tmp_path)
    found = read_table(tmp_path)
    assert found["reason"].tolist() == ["", ""] and set(found["outcome"]) == {"reached"}
    assert np.isfinite(found["safe"][1]) and np.isfinite(found["recovered"][1])
    assert (found["moved"] < 0.003).all() and (found["peak"] < 1.2 * found["limit"]).all()


def test_a_long_run_lets_nothing_grow() -> None:
    seen = soak(soak_scenario(250.0, lockstep=True), 8.0, composed=True)
    assert seen.ticks > 200 and seen.is_held
    found = seen.summary()
    assert found["more_descriptors"] == found["more_threads"] == found["drops"] == 0.0
    assert found["memory_KiB_per_min"] < 30e3 and found["recorder_KiB_per_min"] < 60e3


def test_running_nodes_survive_hostile_bytes(tmp_path: Path) -> None:
    report = fuzz_nodes(4.0, 3, tmp_path)
    assert report.finding == "" and report.inputs > 0
    assert report.growth < 100 * 2**20
