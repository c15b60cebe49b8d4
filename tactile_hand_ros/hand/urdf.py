# SPDX-License-Identifier: Apache-2.0
"""The URDF of a hand as XML, with limits of its size and checks that Pinocchio does not make."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from tactile_hand_ros.config.hand_config import Coupling, HandConfig
from tactile_hand_ros.config.plain_yaml import read_text
from tactile_hand_ros.errors import ConfigurationError, HandModelError
from tactile_hand_ros.hand.extract import cut_at_palm, moved_links, place_joint, take_hand

_MAX_LINKS = 500
_LARGEST_NUMBER = 1e6  # in SI units; far above any hand, far below overflow
_PRINTED = 0.01  # of the largest moment: rounding in a URDF
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_TYPES = ("revolute", "prismatic", "fixed", "continuous", "floating", "planar")
_OF_LINKS = {"inertial/origin": ("xyz", "rpy"), "inertial/mass": ("value",)}
_OF_JOINTS = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("multiplier", "offset"),
    "dynamics": ("damping", "friction"),
}


def describe(config: HandConfig, layout: str = "") -> tuple[str, dict[str, Coupling]]:
    """Return the URDF of a hand in a layout, and its couplings by the joint that follows.

    Raises:
        HandModelError: If the file is not the URDF of a hand, or lacks a link or joint.
    """
    path = config.file
    root = read_urdf(path, config.palm, any_inertia=config.any_inertia)
    couplings = take_hand(root, config, path.name)
    joints = {j.get("name"): j for j in root.iter("joint") if j.get("type") == "fixed"}
    for moved, mount in config.layout(layout).items():
        if moved not in joints:
            raise HandModelError(
                f"the layout moves joint '{moved}', which is not a fixed joint of '{path.name}'; "
                f"fixed joints: {', '.join(str(j) for j in joints)}"
            )
        place_joint(joints[moved], mount.xyz, mount.rpy)
    try:
        return ElementTree.tostring(root, encoding="unicode"), couplings
    except RecursionError:
        raise HandModelError(f"'{path}' is nested too deeply; expected a URDF") from None


def read_urdf(path: Path, palm: str = "", *, any_inertia: bool = False) -> Element:
    """Read a URDF behind its palm, or all of it, and check it.

    Raises:
        HandModelError: If the file is not a URDF, lacks the palm, or has impossible numbers; an
            impossible inertia is kept with `any_inertia`.
    """
    root = _parsed(path)
    links = len(root.findall("link"))
    if links > _MAX_LINKS:
        raise HandModelError(f"'{path.name}' has {links} links; at most {_MAX_LINKS} are read")
    _check_tree(root, path.name)
    if palm:
        cut_at_palm(root, palm, path.name)
    _check_numbers(root, path.name, any_inertia)
    return root


def _parsed(path: Path) -> Element:
    try:
        text = read_text(path)
        if "<!DOCTYPE" in text:  # a few entities can stand for gigabytes
            raise HandModelError(f"'{path}' declares a DOCTYPE; expected a URDF, which has none")
        root = ElementTree.fromstring(text)
        if any("xacro}" in element.tag for element in root.iter()):
            raise ElementTree.ParseError("it has xacro elements")
    except ConfigurationError as error:
        raise HandModelError(
            f"cannot use the hand's URDF {str(error).rstrip('.')}; correct 'urdf' in its YAML"
        ) from None
    except ElementTree.ParseError as error:
        raise HandModelError(
            f"'{path}' is not a URDF: {error}; expand a xacro file with `xacro {path.name}`"
        ) from error
    if root.tag == "mujoco":
        from tactile_hand_ros.hand.mjcf import urdf_of_mjcf  # loads Pinocchio

        return urdf_of_mjcf(path)
    return root


def _check_numbers(root: Element, name: str, any_inertia: bool) -> None:
    for joint in root.findall("joint"):
        for tag, attribute, value in _numbers(joint, _OF_JOINTS, name):
            if tag == "dynamics" and value < 0.0:
                raise _wrong(joint, name, f"{attribute} is {value:g}", "none below 0")
    moved = moved_links(root)
    for link in root.findall("link"):
        moves = link.get("name") in moved  # frames that are fixed to the palm may have no mass
        for tag, attribute, value in _numbers(link, _OF_LINKS, name):
            if attribute == "value" and (value < 0.0 or (moves and value == 0.0)):
                advice = "correct it, or remove <inertial> from a link without mass"
                raise _wrong(link, name, f"{tag} is {value:g}", "a mass above 0 kg", advice)
        if link.find("inertial/inertia") is not None:
            _check_inertia(link, name, any_inertia)


def _check_tree(root: Element, name: str) -> None:
    """Check that links and joints form a tree, with joint types of urdfdom."""
    for kind in ("link", "joint"):
        names = [str(each.get("name")) for each in root.findall(kind)]
        if twice := [each for each in names if names.count(each) > 1]:
            raise HandModelError(f"'{name}' has two {kind}s with the name '{twice[0]}'; rename one")
    links, children = {link.get("name") for link in root.findall("link")}, set()
    for joint in root.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        parent, child = ("" if end is None else str(end.get("link", "")) for end in ends)
        for end, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise _wrong(joint, name, f"its {end} is '{link}'", "a link of this URDF")
        if child in children:
            raise _wrong(joint, name, f"link '{child}' has another parent too", "a tree of links")
        children.add(child)
        kind = str(joint.get("type"))
        if kind not in _TYPES:
            raise _wrong(joint, name, f"its type is '{kind}'", f"one of {', '.join(_TYPES)}")
    if len(links - children) != 1:
        roots = ", ".join(sorted(str(link) for link in links - children)) or "none"
        raise HandModelError(f"'{name}' has the root links {roots}; expected one")


def _check_inertia(link: Element, name: str, any_inertia: bool) -> None:
    """Reject principal moments that are physically impossible."""
    found = _numbers(link, {"inertial/inertia": _INERTIA}, name)
    given = {attribute: value for _, attribute, value in found}
    xx, yy, zz, xy, xz, yz = (given.get(key, 0.0) for key in _INERTIA)
    moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    text = ", ".join(f"{moment:.3g}" for moment in moments)
    wrong = f"inertial/inertia has the principal moments {text}"
    if moments[0] < -1e-9 * np.abs(moments).max():
        raise _wrong(link, name, wrong, "none below 0 kg m^2")
    if not any_inertia and moments[2] > moments[0] + moments[1] + _PRINTED * moments[2]:
        advice = "correct the URDF, or keep it with 'any_inertia: true' in the hand's YAML"
        raise _wrong(link, name, wrong, "none above the sum of the other two", advice)


def _numbers(
    parent: Element, places: Mapping[str, tuple[str, ...]], name: str
) -> Iterator[tuple[str, str, float]]:
    """Yield tag, attribute and value of all numbers at some places of a link or joint.

    Raises:
        HandModelError: If one is not a number, not finite or far too large.
    """
    for tag, attributes in places.items():
        for element, attribute in itertools.product(parent.findall(tag), attributes):
            for word in element.get(attribute, "").split():
                try:
                    value = float(word)
                except ValueError:
                    value = np.nan
                if not abs(value) <= _LARGEST_NUMBER:
                    found = f"{tag} {attribute} has '{word[:40]}'"
                    expected = f"a number of at most {_LARGEST_NUMBER:g}"
                    raise _wrong(parent, name, found, expected)
                yield tag, attribute, value


def _wrong(
    parent: Element, name: str, found: str, expected: str, advice: str = "correct the URDF"
) -> HandModelError:
    label = f"{parent.tag} '{parent.get('name')}'"
    return HandModelError(f"'{name}', {label}: {found}, expected {expected}; {advice}")
