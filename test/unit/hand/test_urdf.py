# SPDX-License-Identifier: Apache-2.0
"""Valid URDF content: joint limits, and the parts that a layout moves."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tactile_hand_ros.config.hand_config import HandConfig, MountConfig
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.urdf import describe, read_urdf

MOMENTS = {"ixx": 2.0, "iyy": 3.0, "izz": 4.0, "ixy": 0.5, "ixz": -0.4, "iyz": 0.3}


def written(folder, inside):
    path = folder / "hand.urdf"
    path.write_text(f'<robot name="some">{inside}</robot>')
    return path


def link(moments=None, mass="1", inertial=""):
    numbers = " ".join(f'{key}="{value!r}"' for key, value in (moments or MOMENTS).items())
    body = inertial or f'<mass value="{mass}"/><inertia {numbers}/>'
    return f'<link name="one"><inertial>{body}</inertial></link>'


def chain(names, kinds, inside=""):
    """Return a serial chain of links with joints of given names and types."""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(names) + 1))
    return links + "".join(
        f'<joint name="{name}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f"{inside}</joint>"
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
    )


LIMIT = '<limit lower="{!r}" upper="1" effort="2" velocity="3"/>'


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_numbers_are_at_most_a_million(tmp_path, sign):
    read_urdf(written(tmp_path, chain("j", ["revolute"], LIMIT.format(sign * 1e6))))
    with pytest.raises(HandModelError, match="'j': limit lower has .*at most 1e"):
        read_urdf(written(tmp_path, chain("j", ["revolute"], LIMIT.format(sign * 1000000.1))))


TREE = chain("ab", ["revolute"] * 2, LIMIT.format(0.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (LIMIT.format(0.0), '<dynamics friction="-1"/>', "joint 'a': friction is -1, expected no"),
        ('<parent link="l0"/>', "", "joint 'a': its parent is '', expected a link"),
        ('<child link="l1"/>', '<child link="x"/>', "joint 'a': its child is 'x', expected a link"),
        ('<child link="l2"/>', '<child link="l1"/>', "joint 'b': link 'l1' has another parent too"),
        ('"revolute"', '"hinge"', "joint 'a': its type is 'hinge', expected one of revolute, pri"),
        ('name="l1"', 'name="l0"', "has two links with the name 'l0'"),
        ('name="b"', 'name="a"', "has two joints with the name 'a'"),
        ('<link name="l0"/>', '<link name="l0"/><link name="x"/>', "has the root links l0, x"),
        (TREE, "", "has the root links none"),
        (TREE, link(inertial='<origin xyz="0 0 x"/>'), "'one': inertial/origin xyz has 'x'"),
        (TREE, link({**MOMENTS, "iyz": "?"}), "link 'one': inertial/inertia iyz has"),
        ("<limit", '<axis xyz="1 b 0"/><limit', "joint 'a': axis xyz has 'b'"),
        ("<link", '<xacro:a xmlns:xacro="a/xacro"/><link', "it has xacro elements; expand a xac"),
        ("<link", "<xacro:a/><link", "is not a URDF: unbound prefix"),
    ],
)
def test_what_no_hand_can_be_built_from_is_named(tmp_path, capfd, old, new, message):
    assert read_urdf(written(tmp_path, TREE))
    with pytest.raises(HandModelError, match=message) as caught:
        read_urdf(written(tmp_path, TREE.replace(old, new, 1)))
    assert "\n" not in str(caught.value) and capfd.readouterr().err == ""


def turned(moments, seed):
    """Return the six numbers of an inertia with given principal moments about other axes."""
    axes = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    (xx, xy, xz), (_, yy, yz), (*_, zz) = (axes * moments @ axes.T).tolist()
    return {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("moments", "message"),
    [
        ([1.0, 2.0, 3.0], ""),
        ([1.0, 2.0, 3.029], ""),  # rounding may remove one percent of the largest
        ([1.0, 2.0, 3.032], "none above the sum"),
        ([-0.9e-9, 1.0, 1.0], ""),
        ([-1.1e-9, 1.0, 1.0], "none below 0"),
        ([-1.1e-12, 1e-3, 1e-3], "none below 0"),
        ([0.0, 0.0, 0.0], ""),
    ],
)
def test_principal_moments_count_about_whatever_axes(tmp_path, moments, message, seed):
    path = written(tmp_path, link(turned(np.array(moments), seed)))
    for any_inertia in (False, True):
        if not message or (any_inertia and "above the sum" in message):
            read_urdf(path, any_inertia=any_inertia)
            continue
        with pytest.raises(HandModelError, match=f"'hand.urdf', link 'one': .*{message}"):
            read_urdf(path, any_inertia=any_inertia)


def test_a_layout_moves_the_joints_that_it_names_and_no_others(tmp_path):
    origin = '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>' + LIMIT.format(0.0)
    written(tmp_path, chain("abc", ("fixed", "fixed", "revolute"), origin))
    mount = MountConfig(xyz=(0.25, -0.5, 4.0), rpy=(0.5, 0.25, -0.125))
    fingers = [{"name": f"f{i}", "tip": "l3", "radius": 0.01} for i in range(3)]
    layouts = {"one": {"b": mount}, "other": {"c": mount}}
    values = {"urdf": "hand.urdf", "palm": "l0", "fingers": fingers, "layouts": layouts}
    config = HandConfig(**values, folder=tmp_path)
    moved = ElementTree.fromstring(describe(config, "one")[0])
    origins = {joint.get("name"): joint.find("origin").attrib for joint in moved.iter("joint")}
    assert origins["b"] == {"xyz": "0.25 -0.5 4.0", "rpy": "0.5 0.25 -0.125"}
    assert origins["a"] == origins["c"] == {"xyz": "1 2 3", "rpy": "0.1 0.2 0.3"}
    with pytest.raises(HandModelError, match="'c', which is not a fixed joint.*joints: a, b"):
        describe(config, "other")


@pytest.mark.parametrize(("name", "weight"), [("paper", 9.81 * 0.5), ("human", 9.81 * 0.06)])
def test_a_finger_weighs_what_its_links_weigh_without_the_palm(name, weight):
    hand = Hand.load(name)
    assert hand.finger_weight == pytest.approx(weight)
    assert hand.minimum_force == pytest.approx(0.01 * weight)
