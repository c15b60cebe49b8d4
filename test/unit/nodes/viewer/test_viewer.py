# SPDX-License-Identifier: Apache-2.0
"""Transforms and markers of the viewer are where the hand is; no tf2 is needed to know it."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
import yaml
from visualization_msgs.msg import Marker

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.scenario import load_scenario
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.viewer.frames import Frame, LinkFrames, contact_frames, transforms
from tactile_hand_ros.nodes.viewer.markers import Scene, markers
from tactile_hand_ros.rotations import rotation_from_quaternion

LAYOUTS = ("three_faces", "pinch")
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_links_are_where_the_hand_has_its_tips(layout: str) -> None:
    hand = Hand.load("paper", layout)
    links = LinkFrames(hand.description)
    theta = np.linspace(-0.4, 0.5, hand.joints)
    found = {frame.name: frame for frame in links.moving(theta)}
    for finger, tip in zip(hand.finger_names, hand.fingertips(theta).positions, strict=True):
        np.testing.assert_allclose(found[f"{finger}_tip"].position, tip, atol=1e-12)
    fixed = {frame.name for frame in links.fixed()}
    assert fixed and not fixed & set(found) and "palm" not in fixed | set(found)
    np.testing.assert_allclose([np.linalg.norm(f.quaternion) for f in found.values()], 1.0)


def test_the_layout_in_force_moves_the_fingers() -> None:
    one, other = (LinkFrames(Hand.load("paper", name).description).fixed() for name in LAYOUTS)
    apart = [np.linalg.norm(a.position - b.position) for a, b in zip(one, other, strict=True)]
    assert max(apart) > 0.1


def test_transforms_of_a_grasp_carry_palm_stamp_and_pose() -> None:
    loop = ClosedLoop(load_scenario("paper", {"duration": 0.01}))
    record = loop.run()
    contacts = record.contact_positions[-1].copy(), record.contact_quaternions[-1]
    contacts[0][1] = np.nan  # finger 2 does not touch
    frames = contact_frames(record.finger_names, *contacts)
    made = transforms(frames, 1_500_000_000)
    assert [each.child_frame_id for each in made] == ["finger_1_contact", "finger_3_contact"]
    assert {each.header.frame_id for each in made} == {"palm"}
    assert (made[0].header.stamp.sec, made[0].header.stamp.nanosec) == (1, 500_000_000)
    move, turn = made[1].transform.translation, made[1].transform.rotation
    assert [move.x, move.y, move.z] == contacts[0][2].tolist()
    back = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).toRotationMatrix()
    np.testing.assert_allclose(back, rotation_from_quaternion(contacts[1][2]), atol=1e-12)


def test_markers_show_what_is_known_and_remove_the_rest() -> None:
    touching = Frame("a_contact", np.array([0.1, 0.0, 0.4]), STRAIGHT)
    lost = Frame("b_contact", np.full(3, np.nan), STRAIGHT)
    forces = np.array([[1.0, 4.0, 0.0], [np.nan] * 3])
    corners = np.eye(3)
    where = Frame("object", np.zeros(3), STRAIGHT)
    scene = Scene(corners, where, [touching, lost], forces, np.array([0.5, np.nan]), where)
    made = markers(scene).markers
    assert [m.ns for m in made] == ["all", "object", "contacts", "forces", "cones", "goal"]
    assert made[0].action == Marker.DELETEALL and made[1].type == Marker.TRIANGLE_LIST
    end = made[3].points[1]
    assert end.y / end.x == pytest.approx(4.0)
    rim = (
        np.array([[p.x, p.y, p.z] for p in made[4].points]).reshape(-1, 3, 3)[:, 1:].reshape(-1, 3)
    )
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 2]), 0.5 * rim[:, 1])
    assert {(m.header.frame_id, m.header.stamp.sec) for m in made} == {("palm", 0)}
    nothing = Scene(corners, None, [lost], forces[1:], np.array([np.nan]), None)
    assert [m.ns for m in markers(nothing).markers] == ["all"]


def test_the_views_name_topics_that_exist() -> None:
    views = config_directory() / "views"
    rviz = yaml.safe_load((views / "tactile_hand.rviz").read_text("utf-8"))
    shown = {each["Class"]: each for each in rviz["Visualization Manager"]["Displays"]}
    assert shown["rviz_default_plugins/MarkerArray"]["Topic"]["Value"] == "/markers"
    description = shown["rviz_default_plugins/RobotModel"]["Description Topic"]
    assert description["Value"] == "/robot_description"
    assert description["Durability Policy"] == "Transient Local"
    assert rviz["Visualization Manager"]["Global Options"]["Fixed Frame"] == "palm"
    layout = json.loads((views / "foxglove.json").read_text("utf-8"))
    assert {"/markers", "/robot_description"} <= set(json.dumps(layout).split('"'))
