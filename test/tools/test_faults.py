# SPDX-License-Identifier: Apache-2.0
"""The fault campaign and the fuzzing of nodes, on real nodes, each for some seconds."""

import numpy as np

from studies.faults.campaign import run_campaign
from studies.faults.space import Injection
from studies.fuzz import fuzz_nodes
from tactile_hand_ros.sweep.table import read_table

DEATHS = [
    Injection("lockstep", "moving", "sensor", "off", 1),
    Injection("lockstep", "moving", "regulator", "stopped", 1),
    Injection("lockstep", "moving", "controller", "off", 1),
]


def test_whatever_node_dies_the_object_stays_in_the_hand_which_then_goes_on(tmp_path):
    run_campaign(DEATHS, tmp_path)
    found = read_table(tmp_path)
    assert found["reason"].tolist() == [""] * 3 and set(found["outcome"]) == {"reached"}
    assert np.isfinite(found["safe"]).all() and np.isfinite(found["recovered"]).all()
    assert (found["moved"] < 0.003).all() and (found["peak"] < 1.2 * found["limit"]).all()


def test_running_nodes_survive_hostile_bytes():
    report = fuzz_nodes(4.0, 3)
    assert report.finding == "" and report.inputs > 0
    assert report.growth < 100 * 2**20
