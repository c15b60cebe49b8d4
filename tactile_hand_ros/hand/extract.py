# SPDX-License-Identifier: Apache-2.0
"""The hand in the URDF of a robot: the links behind the palm, and the joints that move a fingertip.

Joints that move no fingertip are locked at zero. Limits and couplings of the hand's YAML replace
those of the URDF, in which they are often wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, SubElement

from tactile_hand_ros.config.hand_config import Coupling, HandConfig
from tactile_hand_ros.errors import HandModelError

_MOVES = ("revolute", "prismatic", "continuous")
_TURN = 2.0 * math.pi  # rad, limit of a joint that turns without end


def cut_at_palm(root: Element, palm: str, name: str) -> None:
    """Remove all links and joints of a URDF that do not hang on the palm.

    Raises:
        HandModelError: If there is no such link in the file `name`.
    """
    links = [str(link.get("name")) for link in root.findall("link")]
    if palm not in links:
        raise HandModelError(
            f"palm link '{palm}' is not a link of '{name}'; name one of its links as 'palm' in the "
            f"hand's YAML: {', '.join(links)}"
        )
    kept = _with_those_behind(root, {palm})
    for link in root.findall("link"):
        if link.get("name") not in kept:
            root.remove(link)
    for joint in root.findall("joint"):
        parent, child = _ends(joint)
        if parent not in kept or child == palm:
            root.remove(joint)


def moved_links(root: Element) -> set[str]:
    """Return the links of a URDF that some joint moves."""
    joints = (joint for joint in root.findall("joint") if joint.get("type") != "fixed")
    return _with_those_behind(root, {_ends(joint)[1] for joint in joints})


def _with_those_behind(root: Element, links: set[str]) -> set[str]:
    """Return some links and all that hang on them."""
    ends, found = [_ends(joint) for joint in root.findall("joint")], set[str]()
    while not links <= found:
        found |= links
        links = {child for parent, child in ends if parent in found}
    return found


def take_hand(root: Element, config: HandConfig, name: str) -> dict[str, Coupling]:
    """Leave only the joints of the hand movable, and return couplings by the joint that follows.

    `root` is the URDF behind the palm, which is changed, and `name` that of its file.

    Raises:
        HandModelError: If a joint that the YAML names is not there, a joint of the hand has no
            limits, or a coupling has no leader of its own.
    """
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for joint in joints.values():
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            _limit(joint, {"lower": -_TURN, "upper": _TURN})
    for limited, limit in config.limits.items():
        if limited not in joints:
            raise _unknown(limited, "limits", joints, name)
        _limit(joints[limited], limit.model_dump(exclude_none=True))
    couplings = _couplings(joints, config.couplings, name)
    used = _chains(root, [finger.tip for finger in config.fingers])
    used |= {couplings[follower].joint for follower in used & set(couplings)}
    for own, joint in joints.items():
        if joint.get("type") in _MOVES and own not in used:
            joint.set("type", "fixed")  # at zero
            for tag in ("axis", "limit", "mimic", "dynamics"):
                for element in joint.findall(tag):
                    joint.remove(element)
        if joint.get("type") in _MOVES:
            _check_limit(joint, own in couplings, name)
    return {follower: each for follower, each in couplings.items() if follower in used}


def _ends(joint: Element) -> tuple[str, str]:
    """Return the parent and child link of a joint."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None  # checked before
    return str(parent.get("link")), str(child.get("link"))


def _chains(root: Element, tips: list[str]) -> set[str]:
    """Return the moving joints between the palm and some links."""
    above = {_ends(joint)[1]: joint for joint in root.findall("joint")}
    found = set()
    for tip in tips:
        joint = above.get(tip)
        while joint is not None:
            if joint.get("type") in _MOVES:
                found.add(str(joint.get("name")))
            joint = above.get(_ends(joint)[0])
    return found


def _put(joint: Element, tag: str, values: Mapping[str, str]) -> None:
    """Set attributes of a joint's only child with a tag, which is added if it has none."""
    element = joint.find(tag)
    element = SubElement(joint, tag) if element is None else element
    element.attrib.update(values)


def _limit(joint: Element, values: Mapping[str, float]) -> None:
    _put(joint, "limit", {key: repr(float(value)) for key, value in values.items()})


def _check_limit(joint: Element, follows: bool, name: str) -> None:
    """Reject a joint that moves without limits; the torque of one that follows does not count."""
    limit = joint.find("limit")
    limit = Element("limit") if limit is None else limit
    strong = follows or _number(limit, "effort", 0.0) > 0.0
    if not strong or not {"effort", "velocity"} <= set(limit.attrib):
        raise HandModelError(
            f"'{name}', joint '{joint.get('name')}': <limit> needs an effort above 0 and a "
            "velocity; correct the URDF, or give them under 'limits' in the hand's YAML"
        )


def _couplings(
    joints: Mapping[str, Element], wanted: Mapping[str, Coupling], name: str
) -> dict[str, Coupling]:
    """Return all couplings, those of the YAML first, and write them into the joints."""
    found = dict[str, Coupling]()
    for follower, element in joints.items():
        if (mimic := element.find("mimic")) is not None:
            ratio, offset = _number(mimic, "multiplier", 1.0), _number(mimic, "offset", 0.0)
            leader = str(mimic.get("joint"))
            found[follower] = Coupling(joint=leader, ratio=ratio, offset=offset)
    found |= wanted
    for follower, coupling in found.items():
        for joint in (follower, coupling.joint):
            if joint not in joints:
                raise _unknown(joint, f"the coupling of '{follower}'", joints, name)
        is_driven = joints[coupling.joint].get("type") in _MOVES and coupling.joint not in found
        if not is_driven or coupling.ratio == 0.0:
            raise HandModelError(
                f"'{name}', joint '{follower}': it follows '{coupling.joint}' with ratio "
                f"{coupling.ratio:g}, expected a joint that moves on its own and a ratio other than"
                " 0; correct 'couplings' in the hand's YAML"
            )
        numbers = {"multiplier": repr(coupling.ratio), "offset": repr(coupling.offset)}
        _put(joints[follower], "mimic", {"joint": coupling.joint, **numbers})
    return found


def place_joint(joint: Element, xyz: Iterable[float], rpy: Iterable[float]) -> None:
    """Set the origin of a joint: its place, m, and its angles, rad."""
    _put(joint, "origin", {"xyz": " ".join(map(repr, xyz)), "rpy": " ".join(map(repr, rpy))})


def _number(element: Element, key: str, default: float) -> float:
    words = element.get(key, "").split()
    return float(words[0]) if words else default


def _unknown(joint: str, place: str, joints: Mapping[str, Element], name: str) -> HandModelError:
    return HandModelError(
        f"{place} names '{joint}', which is not a joint behind the palm of '{name}'; correct the "
        f"hand's YAML. The joints are: {', '.join(joints)}"
    )
