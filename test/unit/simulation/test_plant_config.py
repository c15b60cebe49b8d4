# SPDX-License-Identifier: Apache-2.0
"""External wrenches over time, and ticks of whole steps."""

import numpy as np
import pytest

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.simulation.plant_config import Disturbance, PlantConfig, external_wrench


@pytest.mark.parametrize(
    ("shape", "factors"),
    [
        ({"kind": "step"}, [0.0, 1.0, 1.0, 1.0]),
        ({"kind": "pulse", "duration": 0.25}, [0.0, 1.0, 1.0, 0.0]),
        ({"kind": "sine", "duration": 0.24, "frequency": 1.25}, [0.0, 0.0, 1.0, 0.0]),
    ],
)
def test_a_disturbance_starts_and_ends(shape, factors):
    push = Disturbance(start=1.0, **shape)
    found = [push.factor(time) for time in (0.999, 1.0, 1.2, 1.25)]
    np.testing.assert_allclose(found, factors, atol=1e-12)


def test_wrenches_add_up():
    pushes = [
        Disturbance(force=(1.0, 0.0, 0.0)),
        Disturbance(start=1.0, force=(1.0, 2.0, 0.0), torque=(0.0, 0.0, 3.0)),
    ]
    np.testing.assert_array_equal(external_wrench(pushes, 0.5), [1.0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(external_wrench(pushes, 1.5), [2.0, 2.0, 0, 0, 0, 3.0])
    np.testing.assert_array_equal(external_wrench([], 1.0), np.zeros(6))


@pytest.mark.parametrize(("rate", "step"), [(300.0, 0.001), (3000.0, 0.001), (700.0, 0.002)])
def test_a_tick_must_be_whole_steps(rate, step):
    with pytest.raises(ConfigurationError, match="expected a whole number"):
        PlantConfig().changed({"rate": rate, "time_step": step})


def test_ticks_are_counted_in_nanoseconds():
    assert PlantConfig(rate=500.0).tick == 2_000_000
    assert PlantConfig(rate=500.0, time_step=0.001).steps_per_tick == 2
    assert PlantConfig(rate=1000.0, time_step=0.001).steps_per_tick == 1
