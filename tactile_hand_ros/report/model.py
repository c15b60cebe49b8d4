# SPDX-License-Identifier: Apache-2.0
"""The bodies in the 3D view: the hand's links, from its URDF, and the object."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import HandModelError, TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report import style
from tactile_hand_ros.rotations import quaternion_from_rotation, rotation_from_vector
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.simulation.solid import Solid


def hand(run: RunData) -> tuple[dict[str, Any] | None, str]:
    """Return the output of `hand_tree`, or None and a sentence if the hand is unknown."""
    try:
        text = _description(run)
        tree = hand_tree(text, run.record.joint_names, _tips(run)) if text else None
    except TactileHandError as error:
        return None, f"The hand cannot be drawn: {error}."
    if tree is None:
        return None, "The bag has neither the hand's URDF nor its scenario; links are not drawn."
    return tree, ""


def _description(run: RunData) -> str:
    """Return the URDF, preferably the recorded one, otherwise that of the scenario."""
    if run.description or run.scenario is None:
        return run.description
    return Hand.load(run.scenario.hand, run.scenario.layout).description


def _tips(run: RunData) -> dict[str, tuple[str, float]]:
    """Return finger and radius by tip link; empty if the hand's file is missing."""
    if run.scenario is None:
        return {}
    try:
        config = load_hand_config(run.scenario.hand)
    except TactileHandError:  # it is on the machine of the run
        return {}
    return {finger.tip: (finger.name, finger.radius) for finger in config.fingers}


def solid(run: RunData) -> tuple[dict[str, Any] | None, str]:
    """Return corners in m, faces and edges of the object, or None and a sentence, if any."""
    if run.scenario is None:
        return None, ""
    try:
        shape = run.scenario.plant.object.solid()
    except TactileHandError as error:  # a mesh on the machine of the run
        return None, f"The object cannot be drawn: {error}."
    return solid_of(shape), ""


def solid_of(shape: Solid) -> dict[str, Any]:
    """Return corners in m, faces and edges of a shape."""
    return {
        "vertices": shape.vertices.tolist(),
        "faces": [corners.tolist() for corners in shape.face_corners],
        "edges": shape.edges.tolist(),
    }


def fingers(names: Sequence[str]) -> list[dict[str, Any]]:
    """Return name, label and color of each finger."""
    return [
        {"name": name, "label": style.pretty(name), "color": style.finger_color(i)}
        for i, name in enumerate(names)
    ]


def joints(
    names: Sequence[str], finger_names: Sequence[str], hand: dict[str, Any] | None
) -> list[dict[str, Any]]:
    """Return name, finger (index, -1 if unknown) and position in the finger of each joint."""
    owner = _owners(finger_names, hand)
    found: list[dict[str, Any]] = []
    for column, name in enumerate(names):
        finger = owner.get(column, -1)
        place = sum(joint["finger"] == finger for joint in found)
        found.append({"label": style.pretty(name), "finger": finger, "place": place})
    return found


def _owners(finger_names: Sequence[str], hand: dict[str, Any] | None) -> dict[int, int]:
    """Return the finger of each joint, by walking from the tips to the palm."""
    found: dict[int, int] = {}
    for tip in hand["tips"] if hand else []:
        link = tip["link"]
        while tip["finger"] in finger_names and link >= 0:
            column = hand["links"][link].get("joint", -1) if hand else -1
            found[column] = finger_names.index(tip["finger"])
            link = hand["links"][link]["parent"] if hand else -1
    found.pop(-1, None)
    return found


_MOVING = {"revolute": "turn", "continuous": "turn", "prismatic": "slide"}


def hand_tree(
    description: str, joint_names: Sequence[str], tips: Mapping[str, tuple[str, float]]
) -> dict[str, Any]:
    """Return the hand as plain data.

    Args:
        description: URDF text.
        joint_names: Names of the joints in the order of the record.
        tips: Finger and radius in m by tip link; links that the URDF lacks are skipped.

    Returns:
        ``links``, parents first, each with ``parent`` (index, -1 for the root), ``xyz`` in m and
        ``quaternion`` (x, y, z, w) in the parent, and for moving joints ``motion`` (turn or slide),
        ``axis`` and ``joint`` (column of the record, -1 if unknown); ``tips`` with ``link``
        (index), ``finger`` (name) and ``radius``.

    Raises:
        HandModelError: If the text is not a URDF.
    """
    try:
        root = ElementTree.fromstring(description)
        links = _links(root, list(joint_names))
    except (ElementTree.ParseError, AttributeError, ValueError) as error:
        raise HandModelError(f"robot_description is not a valid URDF ({error})") from error
    index = {link["name"]: i for i, link in enumerate(links)}
    ends = [
        {"link": index[name], "finger": finger, "radius": radius}
        for name, (finger, radius) in tips.items()
        if name in index
    ]
    return {"links": links, "tips": ends}


def _links(root: ElementTree.Element, joint_names: list[str]) -> list[dict[str, Any]]:
    joints: dict[str, list[ElementTree.Element]] = {}
    for joint in root.findall("joint"):
        joints.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for each in joints.values() for joint in each}
    names = [str(link.get("name")) for link in root.findall("link")]
    links = [_link(name, -1, None, joint_names) for name in names if name not in children]
    placed = {link["name"] for link in links}
    for number, link in enumerate(links):  # grows during the loop, parents first
        for joint in joints.get(link["name"], []):
            child = _end(joint, "child")
            if child not in placed:  # each link once, even if the URDF is not a tree
                placed.add(child)
                links.append(_link(child, number, joint, joint_names))
    return links


def _end(joint: Any, tag: str) -> str:
    return str(joint.find(tag).get("link"))


def _link(
    name: str, parent: int, joint: ElementTree.Element | None, joint_names: list[str]
) -> dict[str, Any]:
    link: dict[str, Any] = {"name": name, "parent": parent}
    if joint is None:
        return link | {"xyz": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0]}
    origin, axis = joint.find("origin"), joint.find("axis")
    link["xyz"] = _numbers(origin, "xyz", "0 0 0")
    link["quaternion"] = _quaternion(_numbers(origin, "rpy", "0 0 0"))
    if motion := _MOVING.get(str(joint.get("type"))):
        known = str(joint.get("name"))
        link["motion"] = motion
        link["axis"] = _numbers(axis, "xyz", "1 0 0")
        link["joint"] = joint_names.index(known) if known in joint_names else -1
    return link


def _numbers(element: ElementTree.Element | None, name: str, default: str) -> list[float]:
    text = default if element is None else element.get(name, default)
    x, y, z = map(float, text.split())
    return [x, y, z]


def _quaternion(rpy: list[float]) -> list[float]:
    roll, pitch, yaw = (rotation_from_vector(a * e) for a, e in zip(rpy, np.eye(3), strict=True))
    return [float(q) for q in quaternion_from_rotation(yaw @ pitch @ roll)]
