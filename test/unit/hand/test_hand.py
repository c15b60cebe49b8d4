# SPDX-License-Identifier: Apache-2.0
"""The hand: the paper's geometry, Jacobians by finite differences, dynamics by first principles.

Also on an arm, with joints that do not count, coupled joints, and limits of its own.
"""

import numpy as np
import pytest
import yaml
from support.hands import changed, kinetic_energy, potential_energy, tip_rotations, write_hand

from tactile_hand_ros.errors import HandModelError
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
    expected = along * np.cos(0.5), 0.6 * np.sin(0.3), along * np.sin(0.5)
    np.testing.assert_allclose(tip, expected, atol=1e-12)


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
    for found in (mixed.tip_positions(theta), mixed.fingertips(theta).positions):
        np.testing.assert_allclose(found, tips.positions, atol=1e-15)
    np.testing.assert_allclose(mixed.fingertips(theta).linear, tips.linear, atol=1e-15)
    expected = tip_rotations(mixed.description, mixed.tip_links, theta)
    np.testing.assert_allclose(mixed.tip_rotations(theta), expected)
    before = inertia.copy(), bias.copy()
    mixed.dynamics(2.0 * theta, 2.0 * rates)
    np.testing.assert_array_equal(inertia, before[0])
    np.testing.assert_array_equal(bias, before[1])


def test_chains_have_a_place_for_each_joint_and_the_tip(mixed):
    theta, _ = random_posture(mixed, 3)
    chains = mixed.joint_positions(theta)
    assert [len(chain) for chain in chains] == [3, 4, 5, 6]
    for chain, base, tip in zip(chains, mixed.bases, mixed.tip_positions(theta), strict=True):
        np.testing.assert_allclose(chain[0], base, atol=1e-15)
        np.testing.assert_allclose(chain[-1], tip, atol=1e-15)


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
    """With twice the lengths and the same masses, gravity has twice the lever at every joint.

    One tip is on the first link: only fixed bodies keep their place.
    """
    mount, down = '<parent link="f1_link_{}"/><child link="f1_tip"/>', np.array([0.0, 0.0, -9.81])
    path = edited(tmp_path, mount.format(3), mount.format(1))
    plain = Hand.load(path, gravity=down)
    long = Hand.load(path, gravity=down, link_lengths=2.0, tip_radii=1.5)
    theta, _ = random_posture(plain, 2)
    torque = plain.gravity_torque(theta)
    np.testing.assert_allclose(long.gravity_torque(theta), 2.0 * torque, atol=1e-12)
    assert np.abs(torque).max() > 0.1
    np.testing.assert_allclose(long.radii, 1.5 * plain.radii)
    reach, longer = (h.tip_positions(theta) - h.bases for h in (plain, long))
    np.testing.assert_allclose(longer, 2.0 * reach, atol=1e-12)
    assert np.linalg.norm(reach[0]) == pytest.approx(0.3) == plain.spans[0]


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


COUPLED = {
    "f1_joint_4": {"joint": "f1_joint_3", "ratio": 0.7, "offset": 0.1},
    "f3_joint_2": {"joint": "f3_joint_1", "ratio": -1.5},
}


def joint(name, parent, child):
    limit = '<limit lower="0.25" upper="2" effort="1" velocity="1"/>'
    origin = '<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/><axis xyz="0 0.6 0.8"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="revolute">{ends}{origin}{limit}</joint>'


def test_a_hand_on_an_arm_is_the_hand_alone(tmp_path):
    """The order of its joints is the same, and another hand on the arm does not count."""
    alone = Hand.load(str(write_hand(tmp_path, [3, 4, 3])))
    arm = '<link name="world"/><link name="other"/>' + joint("elbow", "world", "palm")
    arm += joint("a", "world", "other")
    hand = changed(tmp_path / "hand.yaml", ("</robot>", f"{arm}</robot>"))
    theta = np.random.default_rng(0).uniform(-1.0, 1.0, 10)
    assert hand.joint_names == alone.joint_names and hand.finger_mass == alone.finger_mass
    for one, other in zip(hand.dynamics(theta, theta), alone.dynamics(theta, theta), strict=True):
        for found, expected in zip(one, other, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_joints_that_move_no_fingertip_are_locked_at_zero(tmp_path):
    """The fixed finger weighs what the moving one does at that angle."""
    mass = '<inertial><mass value="2"/><origin xyz="0.3 0.1 0.2"/></inertial>'
    nail = f'<link name="nail">{mass}</link>' + joint("n", "f2_tip", "nail")
    path = write_hand(tmp_path, [3, 3, 3])
    hand = changed(path, ("</robot>", f"{nail}</robot>"))
    assert hand.joints == 9
    fingers = yaml.safe_load(path.read_text())["fingers"]
    moves = changed(path, fingers=[*fingers, {"name": "nail", "tip": "nail", "radius": 0.01}])
    moves.gravity = hand.gravity = np.array([3.0, -4.0, 5.0])
    i, theta = moves.joint_names.index("n"), np.random.default_rng(1).uniform(-1.0, 1.0, 9)
    at = moves.gravity_torque(np.insert(theta, i, 0.0))
    np.testing.assert_allclose(hand.gravity_torque(theta), np.delete(at, i), atol=1e-12)


def test_a_ring_of_links_before_the_palm_is_left_out(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    ring = joint("in", "one", "palm") + joint("out", "palm", "one") + '<link name="one"/>'
    hand = changed(path, ("</robot>", f'{ring}<link name="world"/></robot>'))
    assert hand.joints == 9


def test_limits_of_the_yaml_win(tmp_path):
    before = Hand.load(str(write_hand(tmp_path, [3, 3, 3])))
    limits = {"f2_joint_1": {"lower": -0.2, "effort": 0.17}, "f3_joint_3": {"velocity": 2.5}}
    hand = changed(tmp_path / "hand.yaml", limits=limits)
    lower, upper = hand.position_limits
    expected = before.position_limits[0].copy()
    expected[3] = -0.2
    np.testing.assert_array_equal(lower, expected)
    np.testing.assert_array_equal(upper, before.position_limits[1])
    assert hand.effort_limits[3] == 0.17 and hand.velocity_limits[8] == 2.5
    with pytest.raises(HandModelError, match="limits names 'elbow', which is not a joint"):
        changed(tmp_path / "hand.yaml", limits={"elbow": {"effort": 1.0}})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('effort="30"', 'effort="0"'),
        ('velocity="20"', ""),
        ('<limit lower="-3" upper="3" effort="30" velocity="20"/>', ""),
    ],
)
def test_limits_that_the_urdf_lacks_come_from_the_yaml(tmp_path, old, new):
    """Joints that are locked or cut off need none."""
    path = write_hand(tmp_path, [3, 3, 3])
    nail = '<link name="nail"/>' + joint("n", "f2_tip", "nail").replace('effort="1"', 'effort="0"')
    with pytest.raises(HandModelError, match="joint 'f1_joint_1': <limit> needs an effort"):
        changed(path, (old, new), ("</robot>", nail + "</robot>"))
    limits = {"lower": -1.0, "upper": 2.0, "effort": 0.5, "velocity": 4.0}
    hand = changed(path, limits={"f1_joint_1": limits})
    assert (hand.effort_limits[0], hand.velocity_limits[0]) == (0.5, 4.0)


def test_the_torque_of_a_joint_that_follows_does_not_count(tmp_path):
    path = write_hand(tmp_path, [4, 3, 3], couplings={"f1_joint_4": COUPLED["f1_joint_4"]})
    before, after = (tmp_path / "hand.urdf").read_text().split('<joint name="f1_joint_4"')
    after = after.replace('effort="30"', 'effort="0"', 1)
    (tmp_path / "hand.urdf").write_text(f'{before}<joint name="f1_joint_4"{after}')
    assert Hand.load(str(path)).joints == 9


def test_a_joint_that_turns_without_end_has_a_turn_each_way(tmp_path):
    joint = 'name="f1_joint_2" type="{}"'.format
    endless = joint("revolute"), joint("continuous")
    hand = changed(write_hand(tmp_path, [3, 3, 3]), endless)
    assert [limit[1] for limit in hand.position_limits] == [-2.0 * np.pi, 2.0 * np.pi]
    limits = {"f1_joint_2": {"lower": -0.5, "upper": 1.2}}
    hand = changed(write_hand(tmp_path, [3, 3, 3]), endless, limits=limits)
    assert [limit[1] for limit in hand.position_limits] == [-0.5, 1.2]


def test_a_joint_that_follows_is_no_joint_of_its_own(tmp_path):
    coupled = Hand.load(str(write_hand(tmp_path, [4, 3, 3], couplings=COUPLED)))
    assert coupled.joint_names == [
        "f1_joint_1", "f1_joint_2", "f1_joint_3", "f2_joint_1", "f2_joint_2", "f2_joint_3",
        "f3_joint_1", "f3_joint_3",
    ]  # fmt: skip
    (tmp_path / "free").mkdir()
    free = Hand.load(str(write_hand(tmp_path / "free", [4, 3, 3])))
    theta = np.random.default_rng(2).uniform(-0.8, 0.8, 8)
    every = np.insert(theta, [3, 7], [0.7 * theta[2] + 0.1, -1.5 * theta[6]])
    np.testing.assert_allclose(coupled.tip_positions(theta), free.tip_positions(every), atol=1e-15)
    np.testing.assert_allclose(coupled.tip_rotations(theta), free.tip_rotations(every), atol=1e-15)


@pytest.mark.parametrize("couplings", [COUPLED, {}], ids=["coupled", "free"])
@pytest.mark.parametrize("seed", range(3))
def test_jacobians_inertia_and_weight_are_those_of_the_driven_joints(tmp_path, couplings, seed):
    """Independently: from tip positions, the kinetic energy and the potential."""
    path, gravity = write_hand(tmp_path, [4, 3, 3], couplings=couplings), [2.0, -3.0, 5.0]
    hand, random = Hand.load(str(path), gravity=gravity), np.random.default_rng(seed)
    theta, rates = (random.uniform(-most, most, hand.joints) for most in (0.8, 2.0))
    tips, inertia, bias = hand.dynamics(theta, rates)
    for j, e in enumerate(STEP * np.eye(hand.joints)):
        ahead, behind = hand.tip_positions(theta + e), hand.tip_positions(theta - e)
        np.testing.assert_allclose(tips.linear[:, :, j], (ahead - behind) / (2.0 * STEP), atol=1e-8)
        turn = (hand.tip_rotations(theta + e) - hand.tip_rotations(theta - e)) / (2.0 * STEP)
        spin = turn @ hand.tip_rotations(theta).transpose(0, 2, 1)
        expected = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        np.testing.assert_allclose(tips.angular[:, :, j], expected, atol=1e-8)
        slope = potential_energy(hand, theta + e) - potential_energy(hand, theta - e)
        assert hand.gravity_torque(theta)[j] == pytest.approx(slope / (2.0 * STEP), abs=1e-6)
    np.testing.assert_array_equal(inertia, inertia.T)
    assert 0.5 * rates @ inertia @ rates == pytest.approx(kinetic_energy(hand, theta, rates))
    # Power of the bias: the change of the kinetic energy at constant rates.
    ahead, behind = (theta + sign * STEP * rates for sign in (1.0, -1.0))
    change = kinetic_energy(hand, ahead, rates) - kinetic_energy(hand, behind, rates)
    bias = bias - hand.gravity_torque(theta)
    assert bias @ rates == pytest.approx(change / (2.0 * STEP), abs=1e-6)


def test_who_leads_stops_where_a_follower_would_pass_its_end(tmp_path):
    limits = {
        "f3_joint_1": {"lower": -2.0, "upper": 2.0, "velocity": 5.0},
        "f3_joint_2": {"lower": -1.5, "upper": 0.6, "velocity": 3.0},
    }
    hand = Hand.load(str(write_hand(tmp_path, [4, 3, 3], couplings=COUPLED, limits=limits)))
    lower, upper = hand.position_limits
    assert (lower[6], upper[6]) == (pytest.approx(-0.4), pytest.approx(1.0))
    assert hand.velocity_limits[6] == pytest.approx(2.0)


def test_couplings_of_the_yaml_win_over_mimic_and_are_checked(tmp_path):
    """As in a file whose <mimic> names a joint that does not exist."""
    path, mimic = write_hand(tmp_path, [4, 3, 3]), '<mimic joint="index" multiplier="2"/><axis'
    named = '<joint name="f1_joint_4"'
    before, after = (tmp_path / "hand.urdf").read_text().split(named)
    (tmp_path / "hand.urdf").write_text(before + named + after.replace("<axis", mimic, 1))
    with pytest.raises(HandModelError, match="the coupling of 'f1_joint_4' names 'index'"):
        Hand.load(str(path))
    hand = changed(path, couplings={"f1_joint_4": COUPLED["f1_joint_4"]})
    assert 'joint="f1_joint_3" multiplier="0.7" offset="0.1"' in hand.description
    for ratio, joint in ((0.0, "f1_joint_3"), (1.0, "f1_joint_4")):
        with pytest.raises(HandModelError, match=f"follows '{joint}' with ratio {ratio:g}"):
            changed(path, couplings={"f1_joint_4": {"joint": joint, "ratio": ratio}})


def test_a_fingertip_has_its_center_and_axis_in_the_frame_of_its_link(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    plain = Hand.load(str(path))
    fingers = yaml.safe_load(path.read_text())["fingers"]
    fingers[1] |= {"center": [0.01, -0.02, 0.03], "axis": [0.0, 0.0, 2.0]}
    hand, theta = changed(path, fingers=fingers), np.linspace(-0.5, 0.7, 9)
    turned, before = hand.tip_rotations(theta)[1], plain.tip_rotations(theta)[1]
    np.testing.assert_allclose(turned[:, 0], before[:, 2], atol=1e-12)
    away = hand.tip_positions(theta) - plain.tip_positions(theta)
    np.testing.assert_allclose(away[1], before @ [0.01, -0.02, 0.03], atol=1e-12)
    assert not away[[0, 2]].any()
