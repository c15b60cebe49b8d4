# SPDX-License-Identifier: Apache-2.0
"""Random loads: the same seed gives the same ones, and a reserve is what saves the object."""

import numpy as np

from studies.slip.loads import LoadCase, rows, run_load, sample_loads, study_of
from tactile_hand_ros.sweep.table import keep, read_table

# A light object, hit by a pulse that twists it out of a pinch.
PULSE = LoadCase(
    index=0,
    hand="paper",
    layout="pinch",
    down=(0.0, 0.0, -1.0),
    mass=0.054,
    friction=0.5,
    kind="pulse",
    duration=0.066,
    force=(0.0, -10.0, 0.0),
    torque=(0.0, 0.0, 0.4),
)


def test_equal_seeds_give_equal_loads_of_every_kind():
    cases = sample_loads(100, 3)
    assert cases == sample_loads(100, 3) != sample_loads(100, 4)
    assert len({case.kind for case in cases}) == 4 and len({case.layout for case in cases}) == 2


def test_a_pulse_that_nothing_has_announced_slides_farther_without_a_reserve():
    bare, ready = run_load(PULSE, 0.0), run_load(PULSE, 0.6)
    assert bare["survivable"] and ready["survivable"]
    assert bare["slip"] > 3.0 * ready["slip"] and ready["outcome"] == "reached"
    assert bare["grasp_force"] < ready["grasp_force"] < 20.0


def test_the_table_counts_only_what_can_be_survived():
    table = {
        "floor": np.zeros(6),
        "fraction": np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.2]),
        "grasp_force": np.array([2.0, 4.0, 6.0, 9.0, np.nan, 9.0]),
        "need": np.array([1.0, 1.0, 1.0, 1.0, np.nan, 1.0]),
        "survivable": np.array([True, True, True, False, None, True]),
        "outcome": np.array(["reached", "missed", "lost", "lost", "failed", "reached"]),
    }
    [row, other] = rows(table)
    assert row[:5] == ["0", "10 %", "4", "4.0 N", "4.0"] and other[1:3] == ["20 %", "1"]
    assert row[5].startswith("50.0 %") and row[6].startswith("75.0 %")


def test_a_study_has_a_run_for_each_load_and_reserve(tmp_path):
    reserves = {"floor": (0.0, 0.6), "fraction": (0.2,)}
    keep(study_of(2, 7, reserves), tmp_path)
    found, first = read_table(tmp_path), run_load(sample_loads(2, 7)[0], 0.0)
    assert {name: found[name][0] for name in first} == first
    assert found["floor"].tolist() == [0.0, 0.6, 0.0, 0.6] and set(found["fraction"]) == {0.2}
