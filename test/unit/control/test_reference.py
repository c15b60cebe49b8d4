# SPDX-License-Identifier: Apache-2.0
"""The smooth reference: a critically damped spring in position and orientation, step by step."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.targets import SmoothReference

TIME = 0.1
START, END = np.array([0.1, -0.2, 0.4]), np.array([0.15, 0.1, 0.3])
BEFORE = Rotation.from_rotvec([0.2, -0.1, 0.3])
AXIS = np.array([0.6, 0.0, -0.8])
AFTER = Rotation.from_rotvec(0.5 * AXIS) * BEFORE
NOW = AuxiliaryPose(START, BEFORE.as_matrix())
TARGET = Target(END, AFTER.as_matrix())


def fraction(time):
    """Return how far x'' = (1 - x) / T^2 - 2 x' / T has moved from rest."""
    return 1.0 - (1.0 + time / TIME) * np.exp(-time / TIME)


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.05, 0.4])
def test_position_and_orientation_follow_a_critically_damped_spring_whatever_the_tick(dt):
    """Even if a tick is longer than the time constant, where explicit Euler would diverge."""
    reference = SmoothReference()
    for tick in range(1, round(1.0 / dt) + 1):
        found, share = reference.step(TARGET, NOW, TIME, dt), fraction(tick * dt)
        np.testing.assert_allclose(found.position, START + share * (END - START), atol=1e-12)
        turned = Rotation.from_rotvec(0.5 * share * AXIS) * BEFORE
        np.testing.assert_allclose(found.orientation, turned.as_matrix(), atol=1e-10)


@pytest.mark.parametrize("interrupt", ["no time", "reset"])
def test_it_restarts_at_the_grasp_after_an_interruption(interrupt):
    reference = SmoothReference()
    for _ in range(30):
        reference.step(TARGET, NOW, TIME, 0.002)
    if interrupt == "reset":
        reference.reset()
    else:
        assert reference.step(TARGET, NOW, 0.0, 0.002) is TARGET
    again = reference.step(TARGET, NOW, TIME, 0.002)
    np.testing.assert_allclose(again.position, START + fraction(0.002) * (END - START), atol=1e-12)
