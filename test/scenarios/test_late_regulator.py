# SPDX-License-Identifier: Apache-2.0
"""What real time does to the regulator, without a clock: answers that are late, ticks skipped."""

import numpy as np
import pytest
from support.late import SECONDS, run_late, run_with_late_commands

from tactile_hand_ros.scenario.scenario import load_scenario


@pytest.mark.parametrize("name", SECONDS)
def test_a_regulator_that_is_three_ticks_late_keeps_the_object(name):
    positions, slid, largest = run_late(name)
    assert np.isfinite(positions).all()
    assert slid.max() < 5e-3
    assert largest <= load_scenario(name).slip_regulator.maximum


# Until the grasp force has come to rest after the load.
SHORTER = {"pull": {"duration": 3.0}, "gravity": {"duration": 3.5}}


@pytest.mark.parametrize("name", SHORTER)
def test_commands_that_are_late_now_and_then_are_no_slip(name):
    """By 1 to 3 ticks: the jerks of the torques once raised the grasp force to its limit."""
    _, in_time, _ = run_with_late_commands(name, SHORTER[name], None)
    is_held, grasp_force, slid = run_with_late_commands(name, SHORTER[name], 1)
    assert is_held and slid < 1e-3
    assert grasp_force <= 1.2 * in_time
