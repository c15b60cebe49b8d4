# SPDX-License-Identifier: Apache-2.0
"""A skin that is slow or late, or fails at a finger before a load or during a move.

The contacts of an old skin move with the fingers; the joints replace a failed one.
"""

import functools

import numpy as np
import pytest
from support.outcomes import with_failing_skin

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.scenario.scenario import load_scenario

CASES = {  # scenario, finger, fault, its start and the end of the run, s
    "pulled, off": ("human_pull", 2, "off", 1.0, 3.0),
    "pulled, stuck": ("human_pull", 0, "stuck", 1.0, 3.0),
    "pulled, wrong": ("human_pull", 1, "wrong", 1.0, 3.0),
    "moving, off": ("gravity", 0, "off", 1.5, 4.0),
    "moving, whole": ("gravity", 0, "none", 1.5, 4.0),
}
LATE = {"tactile_sensor.latency": 0.02, "manipulation_controller.touch_latency": 0.022}
OLD = {
    "20 Hz": ("human_hold", {"tactile_sensor.rate": 20.0, "duration": 2.0}),
    "20 Hz, loaded": ("human_lift", {"tactile_sensor.rate": 20.0, "duration": 2.0}),
    "33 Hz": ("human_pull", {"tactile_sensor.rate": 33.0, "duration": 3.0}),
    "20 ms": ("human_pull", {**LATE, "duration": 3.0}),
}


@functools.cache
def record_of(name):
    scenario, finger, fault, begins, ends = CASES[name]
    loop = ClosedLoop(load_scenario(scenario, {"duration": ends}))
    return with_failing_skin(loop, finger, fault, round(loop.scenario.ticks * begins / ends))


@pytest.mark.parametrize("name", CASES)
def test_the_object_is_kept_and_nothing_slides(name):
    """Without the joints, the load would be unknown, and the object lost to 1.5 N."""
    record = record_of(name)
    assert record.stamps[-1] > 0 and np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 1e-4
    assert np.isfinite(record.auxiliary_position[-1]).all()  # it goes on, without a hold


def test_three_fingers_on_one_side_do_not_count_as_a_grasp_without_their_thumb():
    loop = ClosedLoop(load_scenario("allegro", {"duration": 1.2, "targets": []}))
    record = with_failing_skin(loop, 3, "off", loop.scenario.ticks // 2)
    assert np.isfinite(record.auxiliary_position[-1]).all()  # it goes on, without a hold
    moved = np.diff(record.object_position[[loop.scenario.ticks // 2, -1]], axis=0)
    assert np.linalg.norm(moved) < 3e-4 and record.true_slid[-1].max() < 1e-4


def test_a_pull_displaces_the_object_as_little_as_with_a_whole_skin():
    for name in CASES:
        if name.startswith("pulled"):
            moved = np.linalg.norm(np.diff(record_of(name).object_position[[1000, -1]], axis=0))
            assert moved < 1e-3, name


def test_the_hand_moves_on_and_knows_where():
    """The contact of the finger without a skin moves as if it were felt."""
    record, whole = record_of("moving, off"), record_of("moving, whole")
    assert np.linalg.norm(record.object_position[-1] - record.object_position[1500]) > 0.1
    away = np.linalg.norm(record.object_position - whole.object_position, axis=1)
    assert away.max() < 0.01
    true = record.true_positions.mean(axis=1)
    assert np.linalg.norm(record.auxiliary_position - true, axis=1).max() < 5e-4


@pytest.mark.parametrize("name", OLD)
def test_light_fingers_hold_with_old_touch(name):
    """With contacts as old as their samples, they swing and throw the object away."""
    record = simulate(*OLD[name]).record
    assert np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 1e-3
    swings = np.ptp(record.object_position[-200:], axis=0)
    assert swings.max() < 2e-3, swings
