# SPDX-License-Identifier: Apache-2.0
"""What real time does to the regulator, without a clock: answers that are late, ticks skipped."""

import numpy as np
import pytest
from joblib import Parallel, delayed
from support.late import SECONDS, run_late

from tactile_hand_ros.closed_loop.scenario import load_scenario


@pytest.fixture(scope="module")
def outcomes():
    work = Parallel(n_jobs=-1)
    return dict(zip(SECONDS, work(delayed(run_late)(name) for name in SECONDS), strict=True))


@pytest.mark.parametrize("name", SECONDS)
def test_a_regulator_that_is_three_ticks_late_keeps_the_object(outcomes, name):
    positions, slid, largest = outcomes[name]
    assert np.isfinite(positions).all()
    assert slid.max() < 5e-3
    assert largest <= load_scenario(name).slip_regulator.maximum
