# SPDX-License-Identifier: Apache-2.0
"""A hand on an arm, with joints that do not count, coupled joints, and limits of its own."""

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal
from support.hands import changed, kinetic_energy, potential_energy, prism_grasp, write_hand

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.scenario import load_scenario

STEP = 1e-6
COUPLED = {
    "f1_joint_4": {"joint": "f1_joint_3", "ratio": 0.7, "offset": 0.1},
    "f3_joint_2": {"joint": "f3_joint_1", "ratio": -1.5},
}


def joint(name, parent, child, kind="revolute", inside=""):
    limit = '<limit lower="0.25" upper="2" effort="1" velocity="1"/>'
    origin = '<origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/><axis xyz="0 0.6 0.8"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin}{limit}{inside}</joint>'


def test_a_hand_on_an_arm_is_the_hand_alone(tmp_path):
    """The order of its joints is the same, and another hand on the arm does not count."""
    alone = Hand.load(str(write_hand(tmp_path, [3, 4, 3])))
    arm = '<link name="world"/><link name="other"/>' + joint("elbow", "world", "palm")
    hand = changed(
        tmp_path / "hand.yaml", ("</robot>", arm + joint("a", "world", "other") + "</robot>")
    )
    theta = np.random.default_rng(0).uniform(-1.0, 1.0, 10)
    assert hand.joint_names == alone.joint_names and hand.finger_mass == alone.finger_mass
    for one, other in zip(hand.dynamics(theta, theta), alone.dynamics(theta, theta), strict=True):
        for found, expected in zip(one, other, strict=True):
            assert_array_equal(found, expected)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_joints_that_move_no_fingertip_are_locked_nearest_to_zero(tmp_path, kind):
    """Here at 0.25: the fixed finger weighs what the moving one does at that angle."""
    nail = (
        '<link name="nail"><inertial><mass value="2"/><origin xyz="0.3 0.1 0.2"/></inertial></link>'
    )
    path = write_hand(tmp_path, [3, 3, 3])
    hand = changed(path, ("</robot>", nail + joint("n", "f2_tip", "nail", kind) + "</robot>"))
    assert hand.joints == 9
    fingers = yaml.safe_load(path.read_text())["fingers"]
    moves = changed(path, fingers=[*fingers, {"name": "nail", "tip": "nail", "radius": 0.01}])
    moves.gravity = hand.gravity = np.array([3.0, -4.0, 5.0])
    i, theta = moves.joint_names.index("n"), np.random.default_rng(1).uniform(-1.0, 1.0, 9)
    at = moves.gravity_torque(np.insert(theta, i, 0.25))
    assert_allclose(hand.gravity_torque(theta), np.delete(at, i), atol=1e-12)


def test_a_ring_of_links_before_the_palm_is_left_out(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    ring = joint("in", "one", "palm") + joint("out", "palm", "one") + '<link name="one"/>'
    hand = changed(path, ("</robot>", f'{ring}<link name="world"/></robot>'))
    assert hand.joints == 9


def test_a_locked_joint_without_three_numbers_is_named(tmp_path):
    path = write_hand(tmp_path, [3, 3, 3])
    nail = '<link name="nail"/>' + joint("n", "f2_tip", "nail").replace("0 0.6 0.8", "0 1")
    with pytest.raises(HandModelError, match="'0 1', expected three numbers"):
        changed(path, ("</robot>", nail + "</robot>"))


def test_limits_of_the_yaml_win(tmp_path):
    before = Hand.load(str(write_hand(tmp_path, [3, 3, 3])))
    limits = {"f2_joint_1": {"lower": -0.2, "effort": 0.17}, "f3_joint_3": {"velocity": 2.5}}
    hand = changed(tmp_path / "hand.yaml", limits=limits)
    lower, upper = hand.position_limits
    expected = before.position_limits[0].copy()
    expected[3] = -0.2
    assert_array_equal(lower, expected)
    assert_array_equal(upper, before.position_limits[1])
    assert hand.effort_limits[3] == 0.17 and hand.velocity_limits[8] == 2.5
    with pytest.raises(HandModelError, match="limits names 'elbow', which is not a joint"):
        changed(tmp_path / "hand.yaml", limits={"elbow": {"effort": 1.0}})


@pytest.mark.parametrize(
    ("old", "new", "wrong"),
    [
        ('effort="30"', 'effort="0"', "an effort of 0"),
        ('effort="30" velocity="20"', "", "no effort and no velocity"),
        ('<limit lower="-3" upper="3" effort="30" velocity="20"/>', "", "no effort and no .*"),
    ],
)
def test_limits_that_the_urdf_lacks_come_from_the_yaml(tmp_path, old, new, wrong):
    """Joints that are locked or cut off need none."""
    path = write_hand(tmp_path, [3, 3, 3])
    nail = '<link name="nail"/>' + joint("n", "f2_tip", "nail").replace('effort="1"', 'effort="0"')
    with pytest.raises(HandModelError, match=f"joint 'f1_joint_1': <limit> has {wrong}, expected"):
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
    path = write_hand(tmp_path, [3, 3, 3])
    hand = changed(
        path, ('name="f1_joint_2" type="revolute"', 'name="f1_joint_2" type="continuous"')
    )
    assert [limit[1] for limit in hand.position_limits] == [-2.0 * np.pi, 2.0 * np.pi]


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
    assert_allclose(coupled.tip_positions(theta), free.tip_positions(every), atol=1e-15)
    assert_allclose(coupled.tip_rotations(theta), free.tip_rotations(every), atol=1e-15)


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
        assert_allclose(tips.linear[:, :, j], (ahead - behind) / (2.0 * STEP), atol=1e-8)
        slope = potential_energy(hand, theta + e) - potential_energy(hand, theta - e)
        assert hand.gravity_torque(theta)[j] == pytest.approx(slope / (2.0 * STEP), abs=1e-6)
    assert_array_equal(inertia, inertia.T)
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
    path = write_hand(tmp_path, [4, 3, 3], couplings=COUPLED, limits=limits)
    hand = Hand.load(str(path))
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
    assert_allclose(turned[:, 0], before[:, 2], atol=1e-12)
    away = hand.tip_positions(theta) - plain.tip_positions(theta)
    assert_allclose(away[1], before @ [0.01, -0.02, 0.03], atol=1e-12)
    assert not away[[0, 2]].any()


def test_a_hand_with_coupled_joints_holds_an_object(tmp_path):
    """With the last joint of each finger coupled, as in many prostheses, under gravity."""
    couplings = {f"f{i}_joint_4": {"joint": f"f{i}_joint_3", "ratio": 0.5} for i in (1, 2, 3)}
    changes = prism_grasp(tmp_path, [4, 4, 4], couplings=couplings) | {
        "duration": 0.4,
        "targets": [],
    }
    loop = ClosedLoop(load_scenario("gravity", changes))
    assert loop.plant.hand.joints == 9
    record = loop.run()
    assert len(record) == loop.scenario.ticks and np.isfinite(record.true_positions).all()
    assert np.linalg.norm(record.object_position - record.object_position[0], axis=1).max() < 0.005
