# SPDX-License-Identifier: Apache-2.0
"""Palm and links of a hand against an object; fingertips may touch it."""

import numpy as np
from support.hands import changed, write_hand

from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.simulation.solid import Solid


def test_links_inside_the_object_are_named_and_tips_are_not(tmp_path):
    box = '<collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>'
    shapes = [(f'<link name="{n}"/>', f'<link name="{n}">{box}') for n in ("f2_base", "f1_tip")]
    hand = changed(write_hand(tmp_path, [3, 3, 3]), *shapes)
    theta, level = np.full(9, 0.4), np.eye(3)
    links = LinkCollisions(hand, Solid.box(np.array([0.1, 0.04, 0.04])))
    base, tip = hand.bases[1], hand.tip_positions(theta)[0]
    # The two overlap along x; turned by 90 degrees, the long box is too short.
    beside = base + np.array([0.055, 0.0, 0.0])
    assert links.touching(theta, beside, level) == ["f2_base"]
    assert links.touching(theta, beside, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])) == []
    assert links.touching(theta, base + np.array([0.065, 0.0, 0.0]), level) == []
    assert links.touching(theta, tip, level) == []


def test_a_hand_without_shapes_touches_nothing():
    links = LinkCollisions(Hand.load("human"), Solid.box(np.full(3, 0.2)))
    assert links.touching(np.zeros(9), np.zeros(3), np.eye(3)) == []
