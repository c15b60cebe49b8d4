# SPDX-License-Identifier: Apache-2.0
"""Which poses a hand can carry its grasp to."""

import numpy as np
import pytest
from support.hands import write_hand
from support.plants import plant

from tactile_hand_ros.core.errors import PoseError
from tactile_hand_ros.core.hand import Hand
from tactile_hand_ros.core.manipulation import AuxiliaryPose, Target
from tactile_hand_ros.core.reach import check_reach, inverse_kinematics
from tactile_hand_ros.core.rotations import rotation_from_vector

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
    hand = Hand.load("paper")
    beyond = START + np.tile([0.0, 2.0, 0.0], 3)  # abduction ends at 1.5708
    theta, missing = inverse_kinematics(hand, hand.fingertips(beyond).positions, START)
    assert np.abs(theta.reshape(3, 3)[:, 1]).max() <= 1.5708
    assert missing.max() > 1e-3


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
def test_the_shipped_targets_are_in_reach(position, turn):
    reach(Target(np.array(position), rotation_from_vector(turn)))


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
