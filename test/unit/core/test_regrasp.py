# SPDX-License-Identifier: Apache-2.0
"""Letting go and taking again: the fingers leave the object, come back, and hold it as before."""

import numpy as np
import pytest

from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.errors import GraspError
from tactile_hand_ros.core.record import Record
from tactile_hand_ros.core.scenario import load_scenario


@pytest.fixture(scope="module")
def story():
    """Hold for 0.5 s, let go for 1.5 s, and hold again; weightless, so that the cube waits."""
    changes = {
        "targets": [],
        "duration": 6.0,
        "plant.object.mass": 0.2,
        "plant.object.friction": 1.0,
    }
    loop = ClosedLoop(load_scenario("paper", changes))
    hand = loop.plant.hand
    record = Record.empty(loop.scenario.ticks, hand.finger_names, hand.joint_names)
    for row in range(len(record)):
        if row == 250:
            loop.controller.release()
        if row == 1000:
            loop.controller.grasp()
        loop.tick(record, row)
    return record


def test_every_finger_leaves_and_the_object_stays_where_it_was(story):
    open_ = slice(900, 1000)
    assert np.isnan(story.true_positions[open_]).all()
    moved = story.object_position[open_] - story.object_position[240]
    assert np.linalg.norm(moved, axis=1).max() < 0.02


def test_it_is_held_again_with_the_squeeze_that_was_asked_for(story):
    assert np.isfinite(story.true_positions[-500:]).all()
    assert story.true_forces[-1, :, 1].sum() == pytest.approx(story.grasp_force[-1], rel=1e-2)
    assert np.abs(story.rates[-1]).max() < 1e-2


def test_the_new_grasp_is_kept_where_it_was_taken(story):
    assert np.isfinite(story.auxiliary_position[-1]).all()
    late = story.auxiliary_position[-500:]
    assert np.linalg.norm(late - late[-1], axis=1).max() < 1e-3


def test_there_must_be_a_grasp_to_let_go_of():
    loop = ClosedLoop(load_scenario("paper"))
    with pytest.raises(GraspError, match="let all fingers touch"):
        loop.controller.release()


def test_after_an_interruption_the_fingers_go_on_and_do_not_jump():
    """Closing, then three seconds without touch: the posture is that of the last tick."""
    loop = ClosedLoop(load_scenario("paper", {"targets": []}))
    record = Record.empty(200, loop.plant.hand.finger_names, loop.plant.hand.joint_names)
    for row in range(200):
        if row == 50:
            loop.controller.release()
        loop.tick(record, row)
    controller = loop.controller
    controller.grasp()
    theta, rates = record.theta[-1], np.zeros(9)
    nothing = Contacts(np.full((3, 3), np.nan), np.full((3, 3, 3), np.nan))
    silent = np.full((3, 3), np.nan)
    stamp = int(record.stamps[-1]) + 2_000_000
    before = controller.step(stamp, theta, rates, nothing, silent, 10.0).torque
    controller.hold(theta, rates, "no touch")
    later = stamp + 3_000_000_000
    after = controller.step(later, theta, rates, nothing, silent, 10.0).torque
    np.testing.assert_allclose(after, before, atol=1e-6)
    gap = controller.step(later + 3_000_000_000, theta, rates, nothing, silent, 10.0).torque
    assert np.abs(gap - after).max() < 0.2  # a millimetre of stiffness 10 N m/rad
