# SPDX-License-Identifier: Apache-2.0
"""The page draws the same tree of links as the physics."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.model import hand_tree
from tactile_hand_ros.rotations import rotation_from_quaternion, rotation_from_vector

SLIDER = """<robot name="gripper">
  <link name="palm"/>
  <joint name="slide" type="prismatic"><parent link="palm"/><child link="jaw"/>
    <origin xyz="0 0 1" rpy="0 1.5707963267948966 0"/><axis xyz="1 0 0"/></joint>
  <link name="jaw"/>
</robot>"""


def tips_of(tree: dict[str, Any], theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the tips by walking the tree like the page, shape (k, 3)."""
    places: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for link in tree["links"]:
        place = np.array(link["xyz"])
        turn = rotation_from_quaternion(link["quaternion"])
        value = theta[link["joint"]] if link.get("joint", -1) >= 0 else 0.0
        value = link.get("ratio", 1.0) * value + link.get("offset", 0.0)
        if link.get("motion") == "turn":
            turn = turn @ rotation_from_vector(value * np.array(link["axis"]))
        elif link.get("motion") == "slide":
            place = place + turn @ (value * np.array(link["axis"]))
        if link["parent"] >= 0:
            above, frame = places[link["parent"]]
            place, turn = above + frame @ place, frame @ turn
        places.append((place, turn))
    found = [(*places[tip["link"]], np.array(tip["center"])) for tip in tree["tips"]]
    return np.array([place + turn @ center for place, turn, center in found])


@pytest.mark.parametrize(
    ("name", "layout"),
    [("paper", "three_faces"), ("paper", "pinch"), ("ability", ""), ("shadow", "")],
)
def test_tips_are_where_the_physics_has_them(name: str, layout: str) -> None:
    hand = Hand.load(name, layout)
    tree = hand_tree(hand.description, hand.joint_names, load_hand_config(name))
    theta = np.random.default_rng(3).uniform(-1.0, 1.5, hand.joints)
    np.testing.assert_allclose(tips_of(tree, theta), hand.fingertips(theta).positions, atol=1e-12)
    assert [tip["finger"] for tip in tree["tips"]] == hand.finger_names
    assert [tip["radius"] for tip in tree["tips"]] == hand.radii.tolist()


def test_a_tip_without_a_radius_has_that_of_its_sphere_or_is_left_out() -> None:
    config = load_hand_config("paper")
    tips = ({"tip": "jaw", "radius": 0.0}, {"tip": "elsewhere"})
    made = zip(config.fingers, tips, strict=False)
    fingers = [finger.model_copy(update=update) for finger, update in made]
    config = config.model_copy(update={"fingers": fingers})
    ball = (
        '<collision><origin xyz="0 0 0.3"/><geometry><sphere radius="0.02"/></geometry></collision>'
    )
    described = SLIDER.replace('<link name="jaw"/>', f'<link name="jaw">{ball}</link>')
    [tip] = hand_tree(described, [], config)["tips"]
    assert (tip["finger"], tip["radius"], tip["center"]) == ("finger_1", 0.02, (0.0, 0.0, 0.3))
    assert hand_tree(SLIDER, [], config)["tips"] == []


@pytest.mark.parametrize("old", ["</robot>", " 1", '<child link="jaw"/>', '<parent link="palm"/>'])
def test_a_broken_urdf_is_refused(old: str) -> None:
    with pytest.raises(HandModelError, match="URDF"):
        hand_tree(SLIDER.replace(old, "", 1), ["slide"], None)


def test_a_placement_turns_about_fixed_axes_x_first() -> None:
    turned = SLIDER.replace('rpy="0 1.5707963267948966 0"', 'rpy="0.3 -0.5 1.1"')
    [_, jaw] = hand_tree(turned, [], None)["links"]
    expected = Rotation.from_euler("xyz", [0.3, -0.5, 1.1]).as_quat()
    np.testing.assert_allclose(jaw["quaternion"], expected, atol=1e-12)
    assert (jaw["motion"], jaw["axis"], jaw["joint"]) == ("slide", [1.0, 0.0, 0.0], -1)


def test_what_a_urdf_leaves_out_has_its_usual_value() -> None:
    bare = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
      <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>
      <joint name="k" type="fixed"><parent link="b"/><child link="c"/></joint></robot>"""
    root, turning, fixed = hand_tree(bare, ["i", "j"], None)["links"]
    still = {"xyz": [0.0, 0.0, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    assert root == {"name": "a", "parent": -1, **still}
    moving = {"motion": "turn", "axis": [1.0, 0.0, 0.0], "joint": 1}
    assert turning == {"name": "b", "parent": 0, **still, **moving}
    assert fixed == {"name": "c", "parent": 1, **still}
