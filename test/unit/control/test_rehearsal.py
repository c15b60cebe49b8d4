# SPDX-License-Identifier: Apache-2.0
"""The rehearsal's synthetic touch is a grasp that takes every block through a tick."""

import numpy as np
import pytest

from tactile_hand_ros.control.contact import example_touch
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig


@pytest.mark.parametrize("fingers", [3, 4, 5])
def test_fingers_stand_evenly_around_a_cylinder_and_press_inwards(fingers):
    contacts, forces = example_touch(fingers)
    angles = 2.0 * np.pi * np.arange(fingers) / fingers
    outward = np.array([np.cos(angles), np.sin(angles), 0.0 * angles]).T
    np.testing.assert_allclose(contacts.positions, 0.05 * outward, atol=1e-15)
    np.testing.assert_allclose(contacts.normals, -outward, atol=1e-15)
    np.testing.assert_array_equal(forces, [[0.0, 1.0, 0.0]] * fingers)
    assert ForceOptimizer(ForceOptimizerConfig(), fingers).solve(contacts).ok
