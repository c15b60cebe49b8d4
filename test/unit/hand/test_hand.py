# SPDX-License-Identifier: Apache-2.0
"""The hand: the paper's geometry, Jacobians by finite differences, dynamics by first principles."""

import numpy as np
import pytest
from support.hands import changed, tip_rotations, write_hand

from tactile_hand_ros.errors import ConfigurationError, HandModelError
from tactile_hand_ros.hand.hand import Hand

START = np.tile([1.047, 0.0, 1.571], 3)
STEP = 1e-6


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """A hand of four fingers with 2, 3, 4 and 5 joints."""
    return Hand.load(str(write_hand(tmp_path_factory.mktemp("hand"), [2, 3, 4, 5])))


def random_posture(hand, seed=0):
    """Return angles and rates without any symmetry."""
    random = np.random.default_rng(seed)
    return random.uniform(-1.2, 1.2, hand.joints), random.uniform(-2.0, 2.0, hand.joints)


def orientation_of_tips(hand, theta):
    """Return the rotations of the tip links, shape (k, 3, 3)."""
    return tip_rotations(hand.description, [f"{name}_tip" for name in hand.finger_names], theta)


def test_tips_of_the_paper_are_where_trigonometry_puts_them():
    hand = Hand.load("paper")
    reach = 0.3 * (np.cos(1.047) + np.cos(1.047 + 1.571))
    height = 0.3 * (np.sin(1.047) + np.sin(1.047 + 1.571))
    inward = 0.3 + reach
    expected = [[inward, 0.0, height], [-inward, 0.0, height], [0.0, inward, height]]
    np.testing.assert_allclose(hand.fingertips(START).positions, expected, atol=1e-12)
    assert height == pytest.approx(0.4098, abs=5e-5)
    assert reach == pytest.approx(-0.1099, abs=1.5e-4)
    assert not hand.gravity_torque(START).any()  # without gravity, unless it is given


def test_second_joint_turns_across_the_first_link():
    """Joint 2 abducts about z of the frame rotated by joint 1: perpendicular to link 1."""
    hand = Hand.load("paper")
    theta = np.zeros(9)
    theta[:3] = [0.5, 0.3, 0.0]
    tip = hand.fingertips(theta).positions[0] - [0.3, 0.0, 0.0]
    along = 0.6 * np.cos(0.3)
    np.testing.assert_allclose(
        tip, [along * np.cos(0.5), 0.6 * np.sin(0.3), along * np.sin(0.5)], atol=1e-12
    )


def test_pinch_layout_moves_the_bases():
    tips = Hand.load("paper", "pinch").fingertips(START).positions
    inward = Hand.load("paper").fingertips(START).positions[0, 0]
    expected = [[0.08, inward], [-0.08, inward], [0.0, -inward]]
    np.testing.assert_allclose(tips[:, :2], expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_tip_jacobians_are_the_derivatives_of_the_poses(mixed, seed):
    theta, rates = random_posture(mixed, seed)
    tips = mixed.fingertips(theta)
    before, after = theta - STEP * rates, theta + STEP * rates
    linear = mixed.fingertips(after).positions - mixed.fingertips(before).positions
    np.testing.assert_allclose(tips.linear @ rates, linear / (2 * STEP), atol=1e-8)
    turn = (orientation_of_tips(mixed, after) - orientation_of_tips(mixed, before)) / (2 * STEP)
    spin = turn @ orientation_of_tips(mixed, theta).transpose(0, 2, 1)
    expected = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    np.testing.assert_allclose(tips.angular @ rates, expected, atol=1e-8)


def edited(tmp_path, old, new, file="hand.urdf"):
    """Write a valid hand with one text replaced; return its YAML file."""
    path = write_hand(tmp_path, [3, 3, 3])
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    return str(path)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("hand.yaml", "tip: f2_tip", "tip: f2_nail", r"'f2'.*'f2_nail'.*f2_tip"),
        ("hand.yaml", "tip: f2_tip", "tip: f2_base", r"'f2_base'.*not moved by any joint"),
        ("hand.yaml", "urdf: hand.urdf", "urdf: hand.urdf\npalm: p", r"'p' is not .*palm, "),
        ("hand.urdf", 'type="revolute"', 'type="planar"', r"revolute or prismatic"),
        ("hand.yaml", "urdf: hand.urdf", "urdf: /dev/zero", r"/dev/zero.*larger.*correct 'urdf'"),
        ("hand.yaml", "urdf: hand.urdf", 'urdf: "a\\0b"', r"cannot use.*correct 'urdf'"),
        ("hand.urdf", "<robot", "<!DOCTYPE a><robot", r"declares a DOCTYPE"),
        ("hand.urdf", "</robot>", "<a>" * 9999 + "</a>" * 9999 + "</robot>", r"nested too deeply"),
        ("hand.urdf", "</robot>", '<link name="x"/>' * 500 + "</robot>", r"links; at most 500"),
        ("hand.urdf", "<mass value=", '<mass value="0" x=', r"'f1_.*mass is 0, .*above 0"),
        ("hand.urdf", " ixx=", ' ixx="-1" x=', r"'f1_.*principal moments -1"),
        ("hand.urdf", " ixx=", ' ixx="1" x=', r"f1_.*moments 0.002, 0.0025, 1, .*sum.*any_in"),
        ("hand.urdf", "inertial>", "nothing>", r"'f1_joint_1' of .* moves no mass.*<inertial>"),
    ],
)
def test_a_broken_hand_is_explained(tmp_path, file, old, new, message):
    with pytest.raises(HandModelError, match=message):
        Hand.load(edited(tmp_path, old, new, file))


def test_an_inertia_that_no_body_has_is_kept_where_the_hand_says_so(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    assert changed(path, (" ixx=", ' ixx="1" x='), any_inertia=True).joints == 9


def test_angles_that_look_like_degrees_are_questioned(tmp_path):
    bent = "urdf: hand.urdf\nlayouts: {bent: {f1_mount: {rpy: [0, 0, 90]}}}"
    with pytest.raises(ConfigurationError, match=r"\[0, 0, 1.571\] if these are degrees"):
        Hand.load(edited(tmp_path, "urdf: hand.urdf", bent, "hand.yaml"))


def test_joints_may_be_named_like_the_palm_or_a_tip(tmp_path):
    """Joints and links have separate names, although Pinocchio keeps them in one list."""
    plain = Hand.load(edited(tmp_path, "f1_joint_1", "f1_joint_1")).fingertips(np.ones(9))
    for name in ("palm", "f1_tip"):
        hand = Hand.load(edited(tmp_path, "f1_joint_1", name))
        assert hand.joint_names[0] == name
        np.testing.assert_array_equal(hand.fingertips(np.ones(9)).linear, plain.linear)


def test_a_layout_without_an_origin_in_the_urdf_is_applied(tmp_path):
    """A fixed joint without <origin> is at the origin until a layout moves it."""
    path, up = write_hand(tmp_path, [3, 3, 3]), {"f1_mount": {"xyz": [0, 0, 1]}}
    plain = changed(path, ('<origin xyz="0.3 0.0 0" rpy="0 0 0.0"/>', ""), layouts={"up": up})
    tips = [hand.tip_positions(np.zeros(9))[0] for hand in (Hand.load(str(path), "up"), plain)]
    np.testing.assert_allclose(tips[0] - tips[1], [0.0, 0.0, 1.0], atol=1e-12)


def test_a_speed_without_a_limit_is_unlimited(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    hand = Hand.load(str(path))
    np.testing.assert_array_equal(hand.velocity_limits, np.full(9, 20.0))
    np.testing.assert_array_equal(hand.effort_limits, np.full(9, 30.0))
    np.testing.assert_array_equal(hand.position_limits, [[-3.0] * 9, [3.0] * 9])
    limits = changed(path, ('velocity="20"', 'velocity="0"')).velocity_limits
    assert np.isinf(limits[0]) and (limits[1:] == 20.0).all()


def test_tips_frames_and_dynamics_agree_however_they_are_asked_for(mixed):
    theta, rates = random_posture(mixed, 7)
    tips, inertia, bias = mixed.dynamics(theta, rates)
    raw = mixed.raw_dynamics(theta, rates)
    np.testing.assert_array_equal(np.triu(raw.inertia), np.triu(inertia))
    np.testing.assert_array_equal(raw.bias, bias)
    for found in (raw.centers, mixed.tip_positions(theta), mixed.fingertips(theta).positions):
        np.testing.assert_allclose(found, tips.positions, atol=1e-15)
    np.testing.assert_allclose(mixed.fingertips(theta).linear, tips.linear, atol=1e-15)
    np.testing.assert_allclose(mixed.tip_rotations(theta), orientation_of_tips(mixed, theta))
    before = bias.copy()
    mixed.dynamics(theta, 2.0 * rates)
    np.testing.assert_array_equal(bias, before)


def test_chains_have_a_place_for_each_joint_and_the_tip(mixed):
    theta, _ = random_posture(mixed, 3)
    chains = mixed.joint_positions(theta)
    assert [len(chain) for chain in chains] == [3, 4, 5, 6]
    for chain, base, tip in zip(chains, mixed.bases, mixed.tip_positions(theta), strict=True):
        np.testing.assert_allclose(chain[0], base, atol=1e-15)
        np.testing.assert_allclose(chain[-1], tip, atol=1e-15)


def test_inertias_that_are_nearly_singular_are_refused(tmp_path):
    """A link with a trillionth of the mass behind its joint makes the dynamics singular."""
    path = write_hand(tmp_path, [3, 3, 3])
    urdf = tmp_path / "hand.urdf"
    text, count = urdf.read_text(), 0
    for key in ("ixx", "iyy", "izz", "mass value"):
        start = text.rindex(f'{key}="')
        end = text.index('"', start + len(key) + 2)
        text, count = text[:start] + f'{key}="1e-18"' + text[end + 1 :], count + 1
    urdf.write_text(text)
    assert count == 4
    with pytest.raises(HandModelError, match="inertia matrix with the eigenvalue"):
        Hand.load(str(path))


def test_a_tip_on_the_first_link_grows_with_it(tmp_path):
    """The numbering of bodies is irrelevant: only fixed bodies keep their place."""
    mount = '<parent link="f1_link_{}"/><child link="f1_tip"/>'
    path = edited(tmp_path, mount.format(3), mount.format(1))
    plain, long = Hand.load(path), Hand.load(path, link_lengths=2.0)
    theta, _ = random_posture(plain, 8)
    reach, longer = (h.tip_positions(theta)[0] - h.bases[0] for h in (plain, long))
    np.testing.assert_allclose(longer, 2.0 * reach, atol=1e-12)
    assert np.linalg.norm(reach) == pytest.approx(0.3) == plain.spans[0]


def test_weights_and_tips_are_those_of_the_posture_that_is_asked_for(mixed):
    """Pinocchio's arrays are shared: no result may depend on the previous one."""
    (theta, _), (other, faster) = random_posture(mixed, 1), random_posture(mixed, 2)
    asked = ("gravity_torque", "tip_positions", "tip_rotations")
    first = {name: getattr(mixed, name)(theta) for name in asked}
    for name in asked:
        mixed.dynamics(other, faster)
        np.testing.assert_array_equal(getattr(mixed, name)(theta), first[name], err_msg=name)


def test_a_joint_that_slides_makes_its_finger_longer_by_its_own_way(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    plain, joint = Hand.load(str(path)), 'name="f2_joint_3" type="{}"'.format
    limits = {"f2_joint_3": {"lower": -0.4, "upper": 0.1}}
    longer = changed(path, (joint("revolute"), joint("prismatic")), limits=limits)
    np.testing.assert_allclose(longer.spans - plain.spans, [0.0, 0.4, 0.0], atol=1e-12)


def test_links_and_tips_of_other_sizes_swing_with_longer_levers(tmp_path):
    """With twice the lengths and the same masses, gravity has twice the lever at every joint."""
    path, down = str(write_hand(tmp_path, [3, 4, 5])), np.array([0.0, 0.0, -9.81])
    plain = Hand.load(path, gravity=down)
    long = Hand.load(path, gravity=down, link_lengths=2.0, tip_radii=1.5)
    theta, _ = random_posture(plain, 2)
    torque = plain.gravity_torque(theta)
    np.testing.assert_allclose(long.gravity_torque(theta), 2.0 * torque, atol=1e-12)
    assert np.abs(torque).max() > 0.1
    np.testing.assert_allclose(long.radii, 1.5 * plain.radii)
    reach, longer = (h.tip_positions(theta) - h.bases for h in (plain, long))
    np.testing.assert_allclose(longer, 2.0 * reach, atol=1e-12)


def test_inertias_count_against_each_other_and_not_in_kilograms(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    urdf = tmp_path / "hand.urdf"
    text = urdf.read_text().replace('mass value="0.2"', 'mass value="2e-11"')
    for moment in ("0.001", "0.002", "0.0025"):
        text = text.replace(f'"{moment}"', f'"{float(moment) * 1e-10!r}"')
    urdf.write_text(text)
    theta = np.ones(9)
    light = Hand.load(str(path)).dynamics(theta, theta)[1]
    heavy = Hand.load(str(write_hand(tmp_path, [3, 3, 3]))).dynamics(theta, theta)[1]
    np.testing.assert_allclose(1e10 * light, heavy, rtol=1e-9, atol=1e-12)
