# SPDX-License-Identifier: Apache-2.0
"""Which poses a hand can carry its grasp to."""

import numpy as np
import pytest
from support.grasps import contacts_at, moved
from support.hands import write_hand
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.reach import check_reach, inverse_kinematics
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector

START = np.tile([1.047, 0.0, 1.571], 3)


@pytest.mark.parametrize("seed", range(5))
def test_inverse_kinematics_finds_angles_for_reachable_tips(seed):
    hand = Hand.load("paper")
    random = np.random.default_rng(seed)
    wanted = hand.fingertips(START + random.uniform(-0.3, 0.3, 9)).positions
    theta, missing = inverse_kinematics(hand, wanted, START)
    assert missing.max() < 1e-6
    np.testing.assert_allclose(hand.fingertips(theta).positions, wanted, atol=1e-6)


def test_inverse_kinematics_says_how_much_is_missing(tmp_path):
    hand = Hand.load(str(write_hand(tmp_path, [3, 4, 5])))
    straight_up = np.array([[0.3, 0.0, 2.0], [-0.15, 0.26, 0.4], [-0.15, -0.26, 0.4]])
    theta, missing = inverse_kinematics(hand, straight_up, np.full(hand.joints, 0.3))
    assert missing[0] == pytest.approx(1.4, abs=0.01) and missing[1:].max() < 1e-3
    lower, upper = hand.position_limits
    assert (theta >= lower).all() and (theta <= upper).all()


def test_joint_limits_are_kept():
    hand, start = Hand.load("human"), np.tile([1.3, 0.0, 1.1], 3)
    beyond = start + np.tile([0.0, 1.2, 0.0], 3)  # abduction ends at 0.8
    theta, missing = inverse_kinematics(hand, hand.fingertips(beyond).positions, start)
    assert np.abs(theta.reshape(3, 3)[:, 1]).max() <= 0.8
    assert missing.max() > 1e-3


class Carried:
    """A grasp that a rigid motion carries so that its fingertips come where they shall.

    Fingertips, normals and the motion have no symmetry: the wrong way round, they come elsewhere.
    """

    def __init__(self):
        self.hand = Hand.load("paper")
        self.hand.radii = np.array([0.06, 0.03, 0.05])
        self.shift, self.turn = (
            np.array([0.03, -0.04, 0.02]),
            rotation_from_vector([0.3, -0.2, 0.4]),
        )
        self.before = rotation_from_vector([-0.5, 0.3, 0.7])
        self.theta = START + np.linspace(-0.15, 0.15, 9)
        self.tips = self.hand.fingertips(self.theta).positions

    def stretch(self, finger, beyond):
        """Ask for a fingertip that is a distance beyond where the straight finger ends."""
        straight = self.theta.copy()
        straight[3 * finger + 2] = 0.0
        reached = self.hand.fingertips(straight)
        block = reached.linear[finger, :, 3 * finger : 3 * finger + 3]
        outward = np.linalg.svd(block)[0][:, 2]  # where no joint can move it
        outward *= np.sign(outward @ (reached.positions[finger] - self.tips[finger]))
        self.tips[finger] = reached.positions[finger] + beyond * outward

    def check(self):
        contacts = contacts_at(self.tips, [[-1.0, 0.2, 0.1], [0.9, 0.3, -0.2], [0.1, -1.0, 0.3]])
        there = Contacts(
            self.tips + self.hand.radii[:, None] * contacts.normals, contacts.rotations
        )
        now = moved(there, self.turn.T, -self.turn.T @ self.shift)
        pose = AuxiliaryPose(now.centroid, self.before)
        target = Target(self.turn @ now.centroid + self.shift, self.turn @ self.before)
        check_reach(self.hand, START, now, pose, target)


@pytest.mark.parametrize("finger", range(3))
def test_ten_millimetres_may_be_missing_and_no_more(finger):
    grasp = Carried()
    grasp.stretch(finger, 0.0099)
    grasp.check()
    grasp = Carried()
    grasp.stretch(finger, 0.0101)
    with pytest.raises(PoseError, match=rf"finger_{finger + 1} would stay 10 mm short"):
        grasp.check()


@pytest.mark.parametrize(
    ("beyond", "expected"),
    [
        ((0.015, 0.023, 0.0), "finger_2 would stay 23 mm short"),
        ((0.041, 0.0, 0.023), "finger_1 would stay 41 mm short"),
        ((0.005, 0.012, 0.037), "finger_3 would stay 37 mm short"),
    ],
)
def test_the_finger_that_misses_most_is_named_with_what_is_missing(beyond, expected):
    grasp = Carried()
    for finger, distance in enumerate(beyond):
        grasp.stretch(finger, distance)
    with pytest.raises(PoseError, match=expected):
        grasp.check()


def reach(target):
    world = plant()
    contacts = world.state.contacts
    pose = AuxiliaryPose(contacts.centroid, np.eye(3))
    check_reach(world.hand, world.state.theta, contacts, pose, target)


@pytest.mark.parametrize(
    ("position", "turn"),
    [
        ([-0.1, 0.2, 0.4], [0.0, 0.0, 0.0]),
        ([0.0, 0.0434, 0.4098], [0.0, 0.0, 0.2]),
        ([0.05, 0.0, 0.38], [0.0, 0.0, 0.15]),
    ],
)
def test_the_shipped_targets_are_in_reach_and_those_40_cm_higher_are_not(position, turn):
    reach(Target(np.array(position), rotation_from_vector(turn)))
    higher = np.array(position) + [0.0, 0.0, 0.4]
    with pytest.raises(PoseError):
        reach(Target(higher, rotation_from_vector(turn)))


@pytest.mark.parametrize(
    ("position", "turn"),
    [
        ([0.0, 0.0434, 3.0], [0.0, 0.0, 0.0]),
        ([2.0, 0.0, 0.4], [0.0, 0.0, 0.0]),
        ([0.0, 0.0434, 0.9], [2.5, 0.0, 0.0]),
    ],
)
def test_what_is_out_of_reach_is_refused_with_the_finger_and_the_present_pose(position, turn):
    with pytest.raises(PoseError, match=r"finger_\d would stay.*\(0.000, 0.043, 0.410\) m"):
        reach(Target(np.array(position), rotation_from_vector(turn)))


@pytest.mark.parametrize(
    ("position", "turn"),
    [([np.nan, 0.0, 0.4], np.eye(3)), ([0.0, 0.0, 0.4], np.full((3, 3), np.nan))],
)
def test_what_is_not_finite_is_no_pose(position, turn):
    with pytest.raises(PoseError, match="must be finite numbers"):
        reach(Target(np.array(position), turn))


def test_a_refused_pose_is_written_in_whole_millimetres_without_a_sign_of_zero():
    with pytest.raises(PoseError, match=r"pose \(0.000, -0.002, 3.000\) m is out of reach"):
        reach(Target(np.array([-0.0004, -0.0016, 2.9996]), np.eye(3)))
