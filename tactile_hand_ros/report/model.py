# SPDX-License-Identifier: Apache-2.0
"""What the 3D view shows besides arrays: the hand's links and the object's shape."""

from __future__ import annotations

from typing import Any

from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.facts import loose_scenario
from tactile_hand_ros.report.urdf import hand_tree
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import object_config

DESCRIPTION = "robot_description"


def hand(run: Run) -> tuple[dict[str, Any] | None, str]:
    """Return the hand as `hand_tree` gives it, None and a sentence where it is not known."""
    try:
        text = _description(run)
        tree = hand_tree(text, run.record.joint_names, _tips(run)) if text else None
    except TactileHandError as error:
        return None, f"The hand cannot be drawn: {error}."
    if tree is None:
        return None, "The bag has neither the hand's URDF nor its scenario; links are not drawn."
    return tree, ""


def _description(run: Run) -> str:
    """Return the URDF, the recorded one before that of the scenario."""
    topic = run.topics.full(DESCRIPTION)
    if run.summary.counts.get(topic) and run.summary.types[topic] == "std_msgs/msg/String":
        return str(next(read_messages(run.bag, [topic])).message.data)
    told = loose_scenario(run)
    name, layout = told.get("hand"), told.get("layout", "")
    if not isinstance(name, str) or not isinstance(layout, str):
        return ""
    return Hand.load(name, layout).description


def _tips(run: Run) -> dict[str, tuple[str, float]]:
    """Return finger and radius by tip link, nothing where the hand's file is not here."""
    name = loose_scenario(run).get("hand")
    if not isinstance(name, str):
        return {}
    try:
        config = load_hand_config(name)
    except TactileHandError:  # it stayed on the machine of the run
        return {}
    return {finger.tip: (finger.name, finger.radius) for finger in config.fingers}


def solid(run: Run) -> dict[str, Any] | None:
    """Return corners in m, faces and edges of the object; None where its shape is unknown."""
    plant = loose_scenario(run).get("plant")
    if not isinstance(plant, dict) or "object" not in plant:
        return None
    try:
        shape = object_config(plant["object"], "scenario").solid()
    except TactileHandError:
        return None
    return {
        "vertices": shape.vertices.tolist(),
        "faces": [corners.tolist() for corners in shape.face_corners],
        "edges": shape.edges.tolist(),
    }
