# SPDX-License-Identifier: Apache-2.0
"""A skin that is slow or late: its contacts move with the fingers since they were measured."""

import numpy as np
import pytest
from support.outcomes import InParallel, run_scenario

LATE = {"tactile_sensor.latency": 0.02, "manipulation_controller.touch_latency": 0.022}
OLD = {
    "20 Hz": ("human_hold", {"tactile_sensor.rate": 20.0, "duration": 2.0}),
    "20 Hz, loaded": ("human_lift", {"tactile_sensor.rate": 20.0, "duration": 2.0}),
    "33 Hz": ("human_pull", {"tactile_sensor.rate": 33.0, "duration": 3.0}),
    "20 ms": ("human_pull", {**LATE, "duration": 3.0}),
}


@pytest.fixture(scope="module")
def records():
    return InParallel(run_scenario, OLD)


@pytest.mark.parametrize("name", OLD)
def test_light_fingers_hold_with_old_touch(records, name):
    """With contacts as old as their samples, they swing and throw the object away."""
    record = records[name]
    assert np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 1e-3
    swings = np.ptp(record.object_position[-200:], axis=0)
    assert swings.max() < 2e-3, swings
