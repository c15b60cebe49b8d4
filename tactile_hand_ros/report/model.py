# SPDX-License-Identifier: Apache-2.0
"""The bodies in the 3D view: the hand's links, from its URDF, and the object."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element

import pinocchio as pin

from tactile_hand_ros.config.hand_config import FingerConfig, HandConfig, load_hand_config
from tactile_hand_ros.errors import HandModelError, TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.tip_fit import fitted_tips, three_numbers
from tactile_hand_ros.report import style
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.simulation.solid import Solid


def hand(run: RunData) -> tuple[dict[str, Any] | None, str]:
    """Return the output of `hand_tree`, or None and a sentence if the hand is unknown."""
    text = run.description  # the scenario may name another hand than the recorded one
    try:
        if not text and run.scenario is not None:
            text = Hand.load(run.scenario.hand, run.scenario.layout).description
        if text:
            return hand_tree(text, run.record.joint_names, _config(run)), ""
    except TactileHandError as error:
        return None, f"The hand cannot be drawn: {error}."
    return None, "The bag has neither the hand's URDF nor its scenario; links are not drawn."


def _config(run: RunData) -> HandConfig | None:
    """Return the hand's configuration, or None if its file is missing."""
    if run.scenario is None:
        return None
    try:
        return load_hand_config(run.scenario.hand)
    except TactileHandError:  # it is on the machine of the run
        return None


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
    links, tips = (hand["links"], hand["tips"]) if hand else ([], [])
    for tip in tips:
        link = tip["link"]
        while tip["finger"] in finger_names and link >= 0:
            found[links[link].get("joint", -1)] = finger_names.index(tip["finger"])
            link = links[link]["parent"]
    return found


_MOVING = {"revolute": "turn", "continuous": "turn", "prismatic": "slide"}


def hand_tree(
    description: str, joint_names: Sequence[str], config: HandConfig | None
) -> dict[str, Any]:
    """Return the hand of a URDF as plain data.

    `joint_names` are in the order of the record. Without `config` there are no fingertips; those
    that the URDF lacks are skipped.

    Returns:
        ``links``, parents first, each with ``parent`` (index, -1 for the root), ``xyz`` in m and
        ``quaternion`` (x, y, z, w) in the parent, and for moving joints ``motion`` (turn or slide),
        ``axis`` and ``joint`` (column of the record, -1 if unknown), and ``ratio`` and ``offset``
        in rad or m if they follow it; ``tips`` with ``link`` (index), ``finger`` (name), ``radius``
        in m, and ``center`` in m and ``axis`` in the link.

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
        {"link": index[tip.tip], "finger": tip.name, **tip.model_dump(include=_TIP)}
        for tip in _tips(config, description)
        if tip.tip in index
    ]
    return {"links": links, "tips": ends}


_TIP = {"radius", "center", "axis"}


def _tips(config: HandConfig | None, description: str) -> list[FingerConfig]:
    """Return the fingers with tips as in `Hand`; only those with a radius if meshes are missing."""
    if config is None:
        return []
    try:
        return fitted_tips(config, description)[0]
    except TactileHandError:  # they are on the machine of the run
        return [finger for finger in config.fingers if finger.radius > 0.0]


def _links(root: Element, joint_names: list[str]) -> list[dict[str, Any]]:
    joints: dict[str, list[Element]] = {}
    for joint in root.findall("joint"):
        joints.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for each in joints.values() for joint in each}
    names = [str(link.get("name")) for link in root.findall("link")]
    still = {"parent": -1, "xyz": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0]}
    links: list[dict[str, Any]] = [{"name": n, **still} for n in names if n not in children]
    for number, link in enumerate(links):  # grows during the loop, parents first
        for joint in joints.pop(link["name"], []):  # once, even if the URDF is not a tree
            links.append(_moved_link(joint, joint_names) | {"parent": number})
    return links


def _end(joint: Any, tag: str) -> str:
    return str(joint.find(tag).get("link"))


def _moved_link(joint: Element, joint_names: list[str]) -> dict[str, Any]:
    origin, name = joint.find("origin"), str(joint.get("name"))
    turn = pin.rpy.rpyToMatrix(three_numbers(origin, "rpy"))
    link = {
        "name": _end(joint, "child"),
        "xyz": three_numbers(origin, "xyz").tolist(),
        "quaternion": quaternion_from_rotation(turn).tolist(),
    }
    if motion := _MOVING.get(str(joint.get("type"))):
        link["motion"] = motion
        link["axis"] = three_numbers(joint.find("axis"), "xyz", "1 0 0").tolist()
        if name not in joint_names and (mimic := joint.find("mimic")) is not None:
            name = str(mimic.get("joint"))
            link["ratio"] = float(mimic.get("multiplier", 1.0))
            link["offset"] = float(mimic.get("offset", 0.0))
        link["joint"] = joint_names.index(name) if name in joint_names else -1
    return link
