# SPDX-License-Identifier: Apache-2.0
"""The fault campaign and the fuzzing of nodes, on real nodes, each for some seconds."""

import numpy as np

from studies.faults.campaign import run_campaign
from studies.faults.situations import Expected
from studies.faults.space import Injection
from studies.fuzz import fuzz_nodes
from tactile_hand_ros.sweep.table import read_table

DEATHS = [("sensor", "off"), ("regulator", "stopped"), ("controller", "off")]
FLOODS = [("user commands", each) for each in ("garbage", "wrong", "delayed", "intermittent")]
"""What users may send, every 2 ms."""


def test_nodes_that_die_and_floods_of_commands_cost_no_object(tmp_path):
    """A hand without a node holds, and drives when the node is back; a flood stops nothing."""
    faults = [*DEATHS, *FLOODS]
    run_campaign([Injection("lockstep", "moving", *fault, 1) for fault in faults], tmp_path)
    found = read_table(tmp_path)
    assert not any(found["reason"]) and set(found["outcome"]) == {"reached"}
    assert np.isfinite(found["safe"]).tolist() == [fault in DEATHS for fault in faults]
    assert np.isfinite(found["recovered"]).all()
    moved = found["moved"][np.isfinite(found["moved"])]  # some commands move the object
    assert (moved < 0.003).all() and (found["peak"] < 1.2 * found["limit"]).all()


def test_an_object_may_be_late_on_its_path_but_not_go_back_or_leave_it():
    """A fault at 0.6 s meets an object that moves at 0.1 m/s, or is still where it was at 0.4 s."""
    times = np.arange(0.1, 1.05, 0.1)
    path = np.outer(0.1 * times, [1.0, 0.0, 0.0])
    references = Expected(times, path, {0.6: path[5:6] + [0.0, 0.0, 0.002]})
    assert references.distance(path[5:], 0.6) == references.distance(path[3:], 0.6) == 0.0
    assert np.isclose(references.distance(path[[5, 3]], 0.6), 0.02)
    away = path[5:] + [0.0, 0.0, 0.003]
    assert np.isclose(references.distance(away, 0.6), 0.003)
    assert np.isclose(references.distance(away[:1], 0.6), 0.001)  # from an ideal hold
    assert references.distance(np.full((1, 3), np.nan), 0.6) == np.inf


def test_running_nodes_survive_hostile_bytes():
    report = fuzz_nodes(4.0, 3)
    assert report.finding == "" and report.inputs > 0
    assert report.growth < 100 * 2**20
