# SPDX-License-Identifier: Apache-2.0
"""The smooth reference: a critically damped spring in position and orientation, step by step."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.targets import SmoothReference

TIME, DT = 0.1, 0.002
START, END = np.array([0.1, -0.2, 0.4]), np.array([0.15, 0.1, 0.3])
BEFORE = Rotation.from_rotvec([0.2, -0.1, 0.3])
AXIS = np.array([0.6, 0.0, -0.8])
AFTER = Rotation.from_rotvec(0.5 * AXIS) * BEFORE
NOW = AuxiliaryPose(START, BEFORE.as_matrix())
TARGET = Target(END, AFTER.as_matrix())


def shares(ticks):
    """Return which fraction of the way x'' = (1 - x) / T^2 - 2 x' / T has gone after each tick."""
    x, speed, out = 0.0, 0.0, []
    for _ in range(ticks):
        speed += DT * ((1.0 - x) / TIME**2 - 2.0 * speed / TIME)
        x += DT * speed
        out.append(x)
    return out


def test_position_and_orientation_follow_a_critically_damped_spring():
    reference = SmoothReference()
    for tick, share in enumerate(shares(200)):
        found = reference.step(TARGET, NOW, TIME, DT)
        np.testing.assert_allclose(found.position, START + share * (END - START), atol=1e-12)
        turned = Rotation.from_rotvec(0.5 * share * AXIS) * BEFORE
        np.testing.assert_allclose(found.orientation, turned.as_matrix(), atol=1e-10)
        if tick == 49:  # after T it is 1 - 2 / e of the way, to the first order of the steps
            assert share == pytest.approx(1.0 - 2.0 / np.e, abs=0.02)
    assert share == pytest.approx(1.0 - 5.0 * np.exp(-4.0), abs=0.01)


def test_without_a_time_it_is_the_target_itself_and_begins_again_afterwards():
    reference, first = SmoothReference(), shares(1)[0]
    for _ in range(30):
        reference.step(TARGET, NOW, TIME, DT)
    assert reference.step(TARGET, NOW, 0.0, DT) is TARGET
    again = reference.step(TARGET, NOW, TIME, DT)
    np.testing.assert_allclose(again.position, START + first * (END - START), atol=1e-12)
    for _ in range(30):
        reference.step(TARGET, NOW, TIME, DT)
    reference.reset()
    again = reference.step(TARGET, NOW, TIME, DT)
    np.testing.assert_allclose(again.position, START + first * (END - START), atol=1e-12)
