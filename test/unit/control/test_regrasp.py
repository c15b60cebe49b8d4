# SPDX-License-Identifier: Apache-2.0
"""Release and regrasp: the fingers leave the object, return, and hold it as before."""

import numpy as np
import pytest
from support.grasps import contacts_at
from support.outcomes import run_with

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.regrasp import Regrasp, RegraspConfig
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.scenario import load_scenario


@pytest.fixture(scope="module")
def story():
    """Hold for 0.5 s, release for 1.5 s, and hold again; weightless, so that the cube waits."""
    changes = {"targets": [], "duration": 6, "plant.object.mass": 0.2, "plant.object.friction": 1.0}
    loop = ClosedLoop(load_scenario("paper", changes))
    return run_with(loop, {250: loop.controller.release, 1000: loop.controller.grasp})


def test_every_finger_leaves_and_the_object_stays_where_it_was(story):
    open_ = slice(900, 1000)
    assert np.isnan(story.true_positions[open_]).all()
    moved = story.object_position[open_] - story.object_position[240]
    assert np.linalg.norm(moved, axis=1).max() < 0.02


def test_it_is_held_again_with_the_grasp_force_that_was_asked_for(story):
    assert np.isfinite(story.true_positions[-500:]).all()
    assert story.true_forces[-1, :, 1].sum() == pytest.approx(story.grasp_force[-1], rel=1e-2)
    assert np.abs(story.rates[-1]).max() < 1e-2


def test_the_new_grasp_is_kept_where_it_was_taken(story):
    assert np.isfinite(story.auxiliary_position[-1]).all()
    late = story.auxiliary_position[-500:]
    assert np.linalg.norm(late - late[-1], axis=1).max() < 1e-3


CONFIG = RegraspConfig(opening=0.012, speed=0.02, overtravel=0.008)
THETA = np.tile([1.047, 0.0, 1.571], 3) + np.linspace(-0.2, 0.2, 9)
DT = 0.05  # 1 mm at that speed


class Fingers:
    """Fingers with asymmetric contact normals that follow their desired posture."""

    def __init__(self):
        self.hand = Hand.load("paper")
        self.tips = self.hand.fingertips(THETA).positions
        normals = [[-1.0, 0.2, 0.1], [0.9, 0.3, -0.2], [0.1, -1.0, 0.3]]
        self.grip = contacts_at(self.tips, normals)
        self.regrasp = Regrasp(CONFIG, self.hand)

    def touched_by(self, *fingers):
        """Return contacts of the named fingers, NaN for the others."""
        return self.grip.without(~np.isin(np.arange(3), fingers))

    def depths(self, ticks, *touching):
        """Return how far the fingers are along their normals after ticks, shape (3,), mm."""
        for _ in range(ticks):
            posture = self.regrasp.posture(self.touched_by(*touching), DT)
        moves = self.hand.fingertips(posture).positions - self.tips
        depths = (moves * self.grip.normals).sum(axis=1)
        np.testing.assert_allclose(moves, depths[:, None] * self.grip.normals, atol=1e-5)
        return 1e3 * depths


@pytest.fixture
def fingers():
    return Fingers()


def test_fingers_open_against_their_normals_and_close_beyond_the_contacts(fingers):
    fingers.regrasp.leave(THETA, fingers.grip)
    for ticks, depth in ((1, -1.0), (4, -5.0), (7, -12.0), (3, -12.0)):
        # While opening, contact makes no difference.
        np.testing.assert_allclose(fingers.depths(ticks, 0, 2), depth, atol=0.01)
    fingers.regrasp.close()
    for ticks, depth in ((1, -11.0), (11, 0.0), (7, 7.0)):
        np.testing.assert_allclose(fingers.depths(ticks), depth, atol=0.01)


def test_closing_on_nothing_ends_with_a_message_and_an_open_hand(fingers):
    regrasp = fingers.regrasp
    regrasp.leave(THETA, fingers.grip)
    fingers.depths(12)
    regrasp.close()
    np.testing.assert_allclose(fingers.depths(21, 1), [8.0, -12.0, 8.0], atol=0.01)
    first, _, third = fingers.hand.finger_names
    assert f"{first}, {third} closed 8 mm beyond the last contacts" in regrasp.missed
    assert regrasp.active and not regrasp.closing
    np.testing.assert_allclose(fingers.depths(30, 1), -12.0, atol=0.01)
    regrasp.close()
    assert regrasp.closing and not regrasp.missed


def test_while_closing_a_finger_that_touches_waits_for_the_others(fingers):
    fingers.regrasp.leave(THETA, fingers.grip)
    fingers.depths(10)
    fingers.regrasp.close()
    fingers.depths(2)
    np.testing.assert_allclose(fingers.depths(5, 1), [-3.0, -8.0, -3.0], atol=0.01)
    np.testing.assert_allclose(fingers.depths(2, 0, 1), [-3.0, -8.0, -1.0], atol=0.01)
    np.testing.assert_allclose(fingers.depths(3, 0), [-3.0, -5.0, 2.0], atol=0.01)


def test_to_let_go_while_closing_opens_again_from_there_along_the_same_normals(fingers):
    fingers.regrasp.leave(THETA, fingers.grip)
    fingers.depths(10)
    fingers.regrasp.close()
    fingers.depths(4, 2)
    fingers.regrasp.open()
    assert fingers.regrasp.active and not fingers.regrasp.closing
    np.testing.assert_allclose(fingers.depths(1, 0), [-7.0, -7.0, -11.0], atol=0.01)
    np.testing.assert_allclose(fingers.depths(3), [-10.0, -10.0, -12.0], atol=0.01)


def test_a_finger_that_did_not_touch_stays_where_it_is(fingers):
    fingers.regrasp.leave(THETA, fingers.touched_by(0, 2))
    np.testing.assert_allclose(fingers.depths(5), [-5.0, 0.0, -5.0], atol=0.01)


def test_every_release_starts_at_its_own_posture(fingers):
    regrasp = fingers.regrasp
    for theta in (THETA + 0.1, THETA.copy()):
        assert not regrasp.active and not regrasp.closing
        regrasp.leave(theta, fingers.grip)
        assert regrasp.active and not regrasp.closing
        np.testing.assert_allclose(regrasp.posture(fingers.grip, 0.0), theta, atol=1e-9)
        theta += 1.0
        regrasp.posture(fingers.grip, 0.2)
        regrasp.close()
        assert regrasp.active and regrasp.closing
        regrasp.finish()
