# SPDX-License-Identifier: Apache-2.0
"""What a URDF may hold: the limits themselves, and what a layout moves."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tactile_hand_ros.config.hand_config import MountConfig
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.urdf import describe

MOMENTS = {"ixx": 2.0, "iyy": 3.0, "izz": 4.0, "ixy": 0.5, "ixz": -0.4, "iyz": 0.3}


def written(folder, inside):
    path = folder / "hand.urdf"
    path.write_text(f'<robot name="some">{inside}</robot>')
    return path


def link(moments=None, mass="1", inertial=""):
    numbers = " ".join(f'{key}="{value!r}"' for key, value in (moments or MOMENTS).items())
    body = inertial or f'<mass value="{mass}"/><inertia {numbers}/>'
    return f'<link name="one"><inertial>{body}</inertial></link>'


@pytest.mark.parametrize("links", [500, 501])
def test_it_has_at_most_five_hundred_links(tmp_path, links):
    path = written(tmp_path, '<link name="x"/>' * links)
    if links == 500:
        assert describe(path, {}).count("<link") == 500
    else:
        with pytest.raises(HandModelError, match="has 501 links; at most 500"):
            describe(path, {})


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_numbers_are_at_most_a_million(tmp_path, sign):
    place = '<joint name="j"><limit lower="{!r}" upper="1" effort="2" velocity="3"/></joint>'
    describe(written(tmp_path, place.format(sign * 1e6)), {})
    with pytest.raises(HandModelError, match="'j': limit lower has .*at most 1e"):
        describe(written(tmp_path, place.format(sign * 1000000.1)), {})


@pytest.mark.parametrize(
    ("inside", "place"),
    [
        (link(inertial='<origin xyz="0 0 x"/>'), "link 'one': inertial/origin xyz has 'x'"),
        (link(inertial='<origin rpy="0 nan 0"/>'), "link 'one': inertial/origin rpy has 'nan'"),
        (link({**MOMENTS, "iyz": "?"}), "link 'one': inertial/inertia iyz"),
        ('<joint name="j"><origin rpy="0 a 0"/></joint>', "joint 'j': origin rpy has 'a'"),
        ('<joint name="j"><axis xyz="1 b 0"/></joint>', "joint 'j': axis xyz has 'b'"),
        ('<joint name="j"><limit velocity="c"/></joint>', "joint 'j': limit velocity has 'c'"),
        ('<joint name="j"><limit effort="d"/></joint>', "joint 'j': limit effort has 'd'"),
        ('<joint name="j"><limit upper="e"/></joint>', "joint 'j': limit upper has 'e'"),
    ],
)
def test_a_word_that_is_no_number_is_named_with_its_place(tmp_path, inside, place):
    with pytest.raises(HandModelError, match=place):
        describe(written(tmp_path, inside), {})


def test_a_mass_may_be_zero_and_not_less(tmp_path):
    describe(written(tmp_path, link(mass="0")), {})
    with pytest.raises(HandModelError, match="mass is -1e-12, expected a mass >= 0"):
        describe(written(tmp_path, link(mass="-1e-12")), {})


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
        ([1.0, 2.0, 3.029], ""),  # one in a hundred of the largest may be left out in print
        ([1.0, 2.0, 3.032], "none above the sum"),
        ([-0.9e-9, 1.0, 1.0], ""),
        ([-1.1e-9, 1.0, 1.0], "none below 0"),
        ([-1.1e-12, 1e-3, 1e-3], "none below 0"),
        ([0.0, 0.0, 0.0], ""),
    ],
)
def test_principal_moments_count_about_whatever_axes(tmp_path, moments, message, seed):
    path = written(tmp_path, link(turned(np.array(moments), seed)))
    if message:
        with pytest.raises(HandModelError, match=f"'hand.urdf', link 'one': .*{message}"):
            describe(path, {})
        kept = "above the sum" in message
        if kept:
            describe(path, {}, any_inertia=True)
        else:
            with pytest.raises(HandModelError):
                describe(path, {}, any_inertia=True)
    else:
        describe(path, {})


def test_a_layout_moves_the_joints_that_it_names_and_no_others(tmp_path):
    inside = "".join(
        f'<joint name="{name}" type="{kind}"><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/></joint>'
        for name, kind in (("a", "fixed"), ("b", "fixed"), ("c", "revolute"))
    )
    path = written(tmp_path, inside)
    mount = MountConfig(xyz=(0.25, -0.5, 4.0), rpy=(0.5, 0.25, -0.125))
    moved = ElementTree.fromstring(describe(path, {"b": mount}))
    origins = {joint.get("name"): joint.find("origin").attrib for joint in moved}
    assert origins["b"] == {"xyz": "0.25 -0.5 4.0", "rpy": "0.5 0.25 -0.125"}
    assert origins["a"] == origins["c"] == {"xyz": "1 2 3", "rpy": "0.1 0.2 0.3"}
    with pytest.raises(HandModelError, match="'c', which is not a fixed joint.*joints: a, b"):
        describe(path, {"c": mount})


def test_products_of_inertia_that_are_not_given_are_zero(tmp_path):
    describe(written(tmp_path, link({"ixx": 1.0, "iyy": 1.0, "izz": 1.0})), {})
