# SPDX-License-Identifier: Apache-2.0
"""The safe hold keeps squeeze and posture."""

import numpy as np

from tactile_hand_ros.control.safe_hold import HoldConfig, SafeHold

POSTURE = np.array([0.1, 0.2, 0.3])
SQUEEZE = np.array([1.0, -1.0, 0.5])


def test_keeps_the_squeeze_where_it_was_engaged():
    hold = SafeHold(HoldConfig(stiffness=20.0, damping=2.0))
    hold.engage(POSTURE, SQUEEZE)
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3)), SQUEEZE)


def test_springs_back_and_damps():
    hold = SafeHold(HoldConfig(stiffness=20.0, damping=2.0))
    hold.engage(POSTURE, SQUEEZE)
    torque = hold.torque(POSTURE + 0.1, np.array([0.0, 0.5, 0.0]))
    np.testing.assert_allclose(torque, SQUEEZE - 20.0 * 0.1 - [0.0, 1.0, 0.0])


def test_engaging_twice_keeps_the_first_and_releasing_forgets():
    hold = SafeHold(HoldConfig())
    assert not hold.active
    hold.engage(POSTURE, SQUEEZE)
    hold.engage(POSTURE + 1.0, SQUEEZE + 1.0)
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3)), SQUEEZE)
    hold.release()
    assert not hold.active
    hold.engage(POSTURE + 1.0, SQUEEZE + 1.0)
    np.testing.assert_array_equal(hold.torque(POSTURE + 1.0, np.zeros(3)), SQUEEZE + 1.0)


def test_does_not_follow_arrays_that_change_later():
    hold, posture = SafeHold(HoldConfig()), POSTURE.copy()
    hold.engage(posture, SQUEEZE)
    posture += 1.0
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3)), SQUEEZE)
