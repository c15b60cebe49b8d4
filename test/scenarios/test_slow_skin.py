# SPDX-License-Identifier: Apache-2.0
"""A skin of 20 or 33 samples a second: its contacts move with the fingers until the next one."""

import numpy as np
import pytest
from support.outcomes import InParallel, run_scenario

SLOW = {
    "human_hold": {"tactile_sensor.rate": 20.0, "duration": 2.0},
    "human_lift": {"tactile_sensor.rate": 20.0, "duration": 2.0},
    "human_pull": {"tactile_sensor.rate": 33.0, "duration": 3.0},
}


@pytest.fixture(scope="module")
def records():
    return InParallel(run_scenario, {name: (name, changes) for name, changes in SLOW.items()})


@pytest.mark.parametrize("name", SLOW)
def test_light_fingers_hold_with_a_slow_skin(records, name):
    """With contacts as old as their samples, they swing and throw the object away."""
    record = records[name]
    assert np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 1e-3
    swings = np.ptp(record.object_position[-200:], axis=0)
    assert swings.max() < 2e-3, swings
