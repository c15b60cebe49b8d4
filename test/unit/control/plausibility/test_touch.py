# SPDX-License-Identifier: Apache-2.0
"""Joints, contacts and f* that do not fit each other are held against, not followed."""

import numpy as np
import pytest
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Controller, ControllerConfig, Mode
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.control.plausibility.touch import JointWatch

STATE = plant().state
OPTIMAL = ForceOptimizer(ForceOptimizerConfig(), 3).solve(STATE.contacts).forces
STILL = np.zeros(9)


def answers(theta=STATE.theta, contacts=STATE.contacts, optimal=OPTIMAL):
    """Return the answers to a tick of a good grasp, to another one, and to the first again."""
    controller = Controller(ControllerConfig())
    ticks = ((STATE.theta, STATE.contacts, OPTIMAL), (theta, contacts, optimal))
    return [
        controller.step(2_000_000 * i, joints, STILL, touch, shape, 10.0)
        for i, (joints, touch, shape) in enumerate((*ticks, ticks[0]))
    ]


def shifted(*shift):
    return Contacts(STATE.contacts.positions + np.array(shift), STATE.contacts.rotations)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"theta": STATE.theta + 0.2}, "off its fingertip"),
        ({"contacts": shifted(0.02, 0.0, 0.0)}, "20 mm off its fingertip"),
        ({"optimal": OPTIMAL[:, [1, 0, 2]]}, "normal parts"),
        ({"optimal": 3.0 * OPTIMAL}, "add up to 3 instead of 1"),
    ],
)
def test_what_does_not_fit_is_answered_with_the_squeeze_that_was_there(wrong, reason):
    before, held, after = answers(**wrong)
    assert before.mode is Mode.DRIVE and held.mode is Mode.HOLD and reason in held.reason
    np.testing.assert_allclose(held.torque, before.torque, atol=1e-9)
    assert after.mode is Mode.DRIVE


def test_what_fits_within_the_tolerance_drives():
    modes = [answer.mode for answer in answers(STATE.theta + 0.01, shifted(0.002, 0.0, 0.0))]
    assert modes == [Mode.DRIVE] * 3


def test_joints_that_repeat_while_the_contacts_move_are_doubted():
    watch = JointWatch()
    assert watch.step(STATE.theta, STATE.contacts, 0.002) == ""
    assert watch.step(STATE.theta.copy(), shifted(0.001, 0.0, 0.0), 0.002) == ""
    assert "do not change" in watch.step(STATE.theta.copy(), shifted(0.003, 0.0, 0.0), 0.002)
    assert watch.step(STATE.theta + 1e-9, shifted(0.003, 0.0, 0.0), 0.002) == ""
