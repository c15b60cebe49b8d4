# SPDX-License-Identifier: Apache-2.0
"""The safe hold keeps grasp force and posture."""

import numpy as np
import pytest

from studies.faults.situations import SITUATIONS, scenario
from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.control.command_guard import GuardConfig
from tactile_hand_ros.control.holds import PostureHold, PostureHoldConfig

POSTURE = np.array([0.1, 0.2, 0.3])
INTERNAL = np.array([1.0, -1.0, 0.5])
INERTIA = np.array([[0.04, 0.01, 0.0], [0.01, 0.03, 0.002], [0.0, 0.002, 0.008]])


def test_keeps_the_grasp_force_where_it_was_engaged():
    hold = PostureHold(PostureHoldConfig(bandwidth=20.0))
    hold.engage(POSTURE, INTERNAL)
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3), INERTIA), INTERNAL)


def test_springs_back_and_damps():
    hold = PostureHold(PostureHoldConfig(bandwidth=20.0))
    hold.engage(POSTURE, INTERNAL)
    rates = np.array([0.0, 0.5, 0.0])
    torque = hold.torque(POSTURE + [0.1, 0.0, 0.0], rates, INERTIA)
    spring, damping = [1.6, 0.4, 0.0], [0.2, 0.6, 0.04]  # 400 M (0.1, 0, 0) and 40 M (0, 0.5, 0)
    np.testing.assert_allclose(torque, INTERNAL - spring - damping)


def test_whatever_is_read_the_torque_is_finite():
    hold = PostureHold(PostureHoldConfig(bandwidth=20.0))
    hold.engage(POSTURE, INTERNAL)
    for theta, rates in ((POSTURE, [1e308, -1e308, 0.0]), (POSTURE - 1e308, np.zeros(3))):
        assert np.isfinite(hold.torque(theta, np.array(rates), INERTIA)).all()
    far = hold.torque(POSTURE - 50.0, np.zeros(3), INERTIA)
    np.testing.assert_allclose(far, INTERNAL + 400.0 * np.pi * INERTIA.sum(axis=1))
    fast = hold.torque(POSTURE, np.full(3, 2e3), INERTIA)
    np.testing.assert_allclose(fast, INTERNAL - 40.0 * 1e3 * INERTIA.sum(axis=1))


def test_engaging_twice_keeps_the_first_and_releasing_forgets():
    hold = PostureHold(PostureHoldConfig())
    assert not hold.active
    hold.engage(POSTURE, INTERNAL)
    hold.engage(POSTURE + 1.0, INTERNAL + 1.0)
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3), INERTIA), INTERNAL)
    hold.release()
    assert not hold.active
    hold.engage(POSTURE + 1.0, INTERNAL + 1.0)
    np.testing.assert_array_equal(hold.torque(POSTURE + 1.0, np.zeros(3), INERTIA), INTERNAL + 1.0)


def test_does_not_follow_arrays_that_change_later():
    hold, posture, force = PostureHold(PostureHoldConfig()), POSTURE.copy(), INTERNAL.copy()
    hold.engage(posture, force)
    posture += 1.0
    force += 1.0
    np.testing.assert_array_equal(hold.torque(POSTURE, np.zeros(3), INERTIA), INTERNAL)


@pytest.mark.parametrize(("situation", "farthest"), [("heavy", 1e-3), ("moving", 4e-3)])
def test_holds_what_is_heavy_and_what_moves_also_with_torques_three_ticks_late(situation, farthest):
    """For four seconds at 250 Hz: a spring that is too soft lets two fingers buckle."""
    guarded = GuardedLoop(scenario(situation, "processes"), GuardConfig())
    guarded.run(SITUATIONS[situation].time + 0.1)
    loop, controller = guarded.loop, guarded.loop.controller
    controller.step = lambda stamp, theta, rates, *_: controller.hold(theta, rates, "silence")
    watch = Watch(guarded)
    watch.run(4.0, answers=True, delay=3)
    assert watch.moved < farthest and loop.state.contacts.all_touching
