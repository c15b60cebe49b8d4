# SPDX-License-Identifier: Apache-2.0
"""Transforms and markers of the viewer are where the hand is; no tf2 is needed to know it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from tactile_hand_ros import names
from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.nodes.viewer.scene import (
    Frame,
    LinkFrames,
    Scene,
    frame_prefix,
    markers,
    transforms,
)
from tactile_hand_ros.ros.endpoints import message_class

ROOT = Path(__file__).resolve().parents[4]
VIEWS = config_directory() / "views"
RVIZ_TOPICS = {"MarkerArray": "Topic", "RobotModel": "Description Topic"}
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


@pytest.mark.parametrize(
    ("namespace", "prefix"), [("/", ""), ("/left", "left/"), ("/left/arm", "left/arm/")]
)
def test_frames_of_two_hands_differ_by_the_namespace(namespace: str, prefix: str) -> None:
    """All hands share /tf."""
    assert frame_prefix(namespace) == prefix
    where = Frame("object", np.zeros(3), STRAIGHT)
    (made,) = transforms([where], 0, frame_prefix(namespace))
    assert (made.header.frame_id, made.child_frame_id) == (f"{prefix}palm", f"{prefix}object")
    nothing = np.full((0, 3), np.nan)
    scene = Scene(np.eye(3), where, [], nothing, np.array([]), where, frame_prefix(namespace))
    assert {m.header.frame_id for m in markers(scene).markers} == {f"{prefix}palm"}


def topics_and_types() -> dict[str, Any]:
    """Return the message class of each topic in docs/topics.md."""
    text = (ROOT / "docs" / "topics.md").read_text("utf-8").split("## Services")[0]
    rows = re.findall(r"^\| `([\w/]+)` \| (\w+)/(\w+) \|", text, re.M)
    return {f"/{topic}": message_class(f"{package}/msg/{kind}") for topic, package, kind in rows}


def test_the_rviz_view_names_topics_that_exist() -> None:
    rviz = yaml.safe_load((VIEWS / "tactile_hand.rviz").read_text("utf-8"))["Visualization Manager"]
    shown = {each["Class"].removeprefix("rviz_default_plugins/"): each for each in rviz["Displays"]}
    given = {kind: shown[kind][key]["Value"] for kind, key in RVIZ_TOPICS.items()}
    known = topics_and_types()
    assert known[given["MarkerArray"]] is MarkerArray and known[given["RobotModel"]] is String
    assert shown["RobotModel"]["Description Topic"]["Durability Policy"] == "Transient Local"
    assert rviz["Global Options"]["Fixed Frame"] == names.PALM_FRAME


def test_the_foxglove_layout_names_panels_topics_and_fields_that_exist() -> None:
    layout = json.loads((VIEWS / "foxglove.json").read_text("utf-8"))
    known, panels = topics_and_types(), layout["configById"]

    def leaves(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else leaves(part["first"]) + leaves(part["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    scene = panels["3D!hand"]
    assert scene["followTf"] == names.PALM_FRAME
    drawn = [*scene["topics"], *(layer["topic"] for layer in scene["layers"].values())]
    assert {known[topic] for topic in drawn} == {MarkerArray, String}
    plotted = [line["value"] for panel in panels.values() for line in panel.get("paths", [])]
    assert len(plotted) == 3
    for path in plotted:
        topic, *fields = path.split(".")
        value = known[topic]()
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, float), path
