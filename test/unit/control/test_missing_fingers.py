# SPDX-License-Identifier: Apache-2.0
"""A hand with more than three fingers holds with the touching ones, and the others return."""

import numpy as np
import pytest
from support.grasps import contacts_at
from support.hands import prism_grasp, write_hand
from support.outcomes import run_with, with_failing_skin

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import (
    AuxiliaryPose,
    LawConfig,
    LawInput,
    ManipulationLaw,
    Target,
)
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    Status,
)
from tactile_hand_ros.control.reach import check_reach
from tactile_hand_ros.control.regrasp import Regrasp, RegraspConfig
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Fingertips, Hand
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

STILL = Joints(np.zeros(12), np.zeros(12))  # of four fingers
GAINS = {f"manipulation_controller.law.{name}": 0.0 for name in ("k_p", "k_o", "damping")}
BLOW = {"kind": "pulse", "start": 0.3, "duration": 0.03, "force": [-22.0, 0.0, 0.0]}


def scenario_of(folder, fingers, duration, changes, away=0.0):
    """Return a scenario of a hand around a prism of 0.2 kg; finger 1 starts away, rad."""
    values = prism_grasp(folder, [3] * fingers)
    values["plant.initial_joints"][0] -= away
    values |= GAINS | {"duration": duration, "plant.object.mass": 0.2, "targets": []}
    return load_scenario("gravity", values | changes)


def ring(fingers, without=()):
    """Return contacts of fingers around an upright cylinder; NaN for missing ones."""
    angles = 2.0 * np.pi * np.arange(fingers) / fingers + 0.1
    outward = np.stack([np.cos(angles), np.sin(angles), 0.2 * np.cos(3.0 * angles)], axis=1)
    contacts = contacts_at(0.1 * outward, -outward)
    contacts.positions[list(without)] = contacts.rotations[list(without)] = np.nan
    return contacts


def without_first(world):
    """Return the contacts of a loop or plant of four fingers without that of the first."""
    return world.state.contacts.without(np.arange(4) == 0)


@pytest.mark.parametrize("fingers", [4, 5])
def test_a_finger_that_a_blow_parts_from_the_object_comes_back(tmp_path, fingers):
    """The others do not wait for it: there is no hold, and the pose does not jump."""
    changes = {"plant.disturbances": [BLOW]}
    loop = ClosedLoop(scenario_of(tmp_path, fingers, 0.6, changes))
    record = loop.run()
    touching = np.isfinite(record.true_positions[:, :, 0])
    assert touching.sum(axis=1).min() >= 3
    assert not touching.all() and touching[-200:].all()
    seen = record.auxiliary_position[np.isfinite(record.auxiliary_position[:, 0])]
    assert len(seen) == len(record.stamps)
    assert np.abs(np.diff(seen, axis=0)).max() < 1e-3
    assert np.linalg.norm(record.object_position[-1] - record.object_position[0]) < 5e-3


def test_a_finger_that_starts_off_the_object_closes_while_four_hold(tmp_path):
    loop, said = ClosedLoop(scenario_of(tmp_path, 5, 1.3, {}, away=0.05)), []
    record = run_with(loop, {201: lambda: said.append(loop.controller.missing)})
    assert said[0].startswith("no contact at f1")
    hand = loop.controller.hand
    tips = [hand.tip_positions(record.theta[row])[0] for row in (300, 600)]
    speed = loop.scenario.manipulation_controller.regrasp.speed  # also against its weight
    assert np.linalg.norm(tips[1] - tips[0]) / 0.3 == pytest.approx(speed, rel=0.1)
    touching = np.isfinite(record.true_positions[:, 0, 0])
    came = int(touching.argmax())
    assert 0 < came < 1200 and touching[came:].all()
    assert loop.controller.missing == ""
    held = record.true_forces[came - 100 : came, 1:, 1].sum(axis=1).mean()
    assert held == pytest.approx(record.grasp_force[came - 50], rel=0.1)
    assert record.grasp_force[-1] < 1.5 * record.grasp_force[came - 1]
    assert record.true_forces[-1, 0, 1] > 1.0  # it presses
    assert record.true_slid.max() < 1e-4


def test_an_obstacle_off_the_skin_is_pressed_softly(tmp_path):
    """The skin of finger 1 fails during the grasp: it opens and leans on the object."""
    loop = ClosedLoop(scenario_of(tmp_path, 4, 0.6, {}))
    record = with_failing_skin(loop, 0, "off", 301)
    assert record.true_forces[290, 0, 1] > 2.0
    weight = loop.controller.hand.finger_weight
    assert 0.0 < record.true_forces[-50:, 0, 1].mean() < 0.3 * weight
    assert np.linalg.norm(record.object_position[-1] - record.object_position[0]) < 2e-3


def test_a_hand_of_four_presses_on_where_the_touch_of_one_is_rejected(tmp_path):
    """The other three do not balance alone, so that what they lack is no load."""
    loop = ClosedLoop(scenario_of(tmp_path, 4, 0.6, {}))
    record = with_failing_skin(loop, 1, "wrong", 300)
    np.testing.assert_array_equal(loop.controller.touch_rejected, [False, True, False, False])
    assert record.grasp_force.max() < 2.0 * record.grasp_force[299]
    assert record.true_forces[-1, :, 1].min() > 3.0 and record.true_slid.max() < 1e-4


@pytest.mark.parametrize(("fingers", "without"), [(4, [1]), (5, [0]), (5, [1, 4])])
@pytest.mark.parametrize("cones", [False, True])
def test_f_star_is_that_of_a_hand_with_just_the_fingers_that_touch(fingers, without, cones):
    weights = list(np.linspace(1.0, 5.0, 3 * fingers))
    touching = np.setdiff1d(np.arange(fingers), without)
    part = np.reshape(weights, (-1, 3))[touching].ravel().tolist()
    whole = ForceOptimizer(ForceOptimizerConfig(weights=weights, cones=cones), fingers)
    fewer = ForceOptimizer(ForceOptimizerConfig(weights=part, cones=cones), len(touching))
    contacts, loads = ring(fingers, without), np.tile([0.1, 0.3, 0.2], (fingers, 1))
    carried = CarriedLoad(loads, np.linspace(0.4, 0.5, fingers), np.linspace(0.1, 0.2, fingers))
    for stamp in (1_000_000, 2_000_000):
        found = whole.step(stamp, contacts, carried, 2.0)
        some = Contacts(contacts.positions[touching], contacts.rotations[touching])
        expected = fewer.step(stamp, some, CarriedLoad(*(x[touching] for x in carried)), 2.0)
        assert found.status is Status.SOLVED
        assert found.forces[touching] == pytest.approx(expected.forces, abs=1e-12)
        assert (found.forces[without] == 0.0).all()


def four_fingers(folder):
    """Return a regulator in mode `auto` of a hand with four fingers."""
    return SlipRegulator(SlipRegulatorConfig(mode="auto", hand=str(write_hand(folder, [3] * 4))))


def test_the_grasp_force_stays_where_the_others_need_no_more(tmp_path):
    """Two fingers carry nearly all of the load; one of the other two opens."""
    regulator = four_fingers(tmp_path)
    forces = np.array([[0.0, x, 0.0] for x in (4.0, 0.2, 4.0, 0.2)])
    for tick in range(300):
        contacts = ring(4, [3] if tick >= 200 else [])
        forces[3] = 0.2 * (tick < 200)
        seen = np.where(forces > 0.0, forces + 1e-3 * np.sin(tick + np.arange(4.0))[:, None], 0.0)
        regulator.step(1_000_000 * tick, STILL, contacts, seen)
        if tick == 199:
            before = regulator.grasp_force
    assert regulator.grasp_force < 1.3 * before


@pytest.mark.parametrize("measured", ["all axes", "normals"])
def test_a_finger_that_is_not_part_of_the_grasp_is_not_lost_when_touch_is_rejected(
    tmp_path, measured
):
    regulator, forces = four_fingers(tmp_path), np.zeros((4, 3))
    for tick in range(500):
        forces[:3, 1] = [4.0, 0.2, 4.0] + 1e-3 * np.sin(tick + np.arange(3.0))
        if measured == "normals":
            forces[:, ::2] = np.nan
        if tick == 300:
            before = regulator.grasp_force
        regulator.reject_touch(np.array([False, 300 <= tick < 310, False, False]))
        regulator.step(1_000_000 * tick, STILL, ring(4, [3]), forces)
    assert regulator.grasp_force <= before


def test_with_normal_forces_of_some_fingers_the_user_can_lower_the_grasp_force(tmp_path):
    hand = str(write_hand(tmp_path, [3] * 4))
    regulator = SlipRegulator(SlipRegulatorConfig(mode="shared", hand=hand))
    forces = np.full((4, 3), np.nan)
    for tick in range(6000):
        if tick in (0, 2000):
            regulator.request(8.0 if tick else 20.0)
        forces[:, 1] = [3.0, 3.0, 3.0, 0.0] + 1e-3 * np.sin(tick + np.arange(4.0))
        regulator.step(1_000_000 * tick, STILL, ring(4, [3]), forces)
        assert tick != 1999 or regulator.grasp_force == pytest.approx(20.0)
    assert regulator.grasp_force == pytest.approx(8.0)


def test_a_contact_that_flickers_leaves_the_others_their_reserve(tmp_path):
    k_f = {}
    for every in (0, 2, 40):  # ticks from loss to loss, 0 without any
        regulator = four_fingers(tmp_path)
        for tick in range(2000):
            lost = every > 0 and tick % every == 0
            noise = 1e-3 * np.sin(tick + np.arange(12.0)).reshape(4, 3)
            forces = np.array([0.0, 3.0, 0.0]) + noise
            forces[3] *= not lost
            regulator.step(1_000_000 * tick, STILL, ring(4, [3] if lost else []), forces)
        k_f[every] = regulator.grasp_force
    assert min(k_f[2], k_f[40]) > 0.9 * k_f[0]


def test_the_pose_and_the_carried_wrench_survive_a_change_of_the_fingers_that_touch():
    """The wrench refers to the centroid: if it moves, the torque changes, but not the load."""
    config = LawConfig(k_p=1.0, k_o=1.0, integral={"k_p": 50.0, "k_o": 1.0, "force_limit": 9.0})
    law, contacts = ManipulationLaw(config, np.full(4, 0.01)), ring(4)
    tips = Fingertips(contacts.positions, np.zeros((4, 3, 12)), np.zeros((4, 3, 12)))
    before = law.auxiliary_pose(tips, contacts)
    target = before._replace(position=before.position + [0.01, 0.02, 0.03])
    law.step(LawInput(tips, contacts, np.zeros((4, 3)), 1.0), np.zeros(12), target, before, 0.1)
    wrench, middle = law.integral.copy(), contacts.centroid
    fewer = contacts.part(np.array([True, True, False, True]))
    law.change_fingers()
    after = law.auxiliary_pose(tips, fewer)
    assert after.position == pytest.approx(before.position)
    assert after.orientation == pytest.approx(before.orientation)
    moved = law.integral
    assert moved[:3] == pytest.approx(wrench[:3]) and np.linalg.norm(wrench[:3]) > 0.1
    torques = [w[3:] + np.cross(c, w[:3]) for w, c in ((wrench, middle), (moved, fewer.centroid))]
    assert torques[1] == pytest.approx(torques[0])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = law.auxiliary_pose(tips, Contacts(fewer.positions @ turn.T, turn @ fewer.rotations))
    assert turned.position == pytest.approx(turn @ before.position)
    assert turned.orientation == pytest.approx(turn @ before.orientation)


def test_a_part_of_a_hand_has_its_joints_and_gravity(tmp_path):
    hand = Hand.load(str(write_hand(tmp_path, [3, 4, 3, 3])))
    chosen = np.array([True, False, True, True])
    part, theta = hand.part(chosen), np.linspace(0.1, 0.9, hand.joints)
    hand.gravity = np.array([1.0, 2.0, 3.0])
    assert part.finger_names == ["f1", "f3", "f4"] and part.joints == hand.joints == 13
    whole, some = hand.dynamics(theta, theta), part.dynamics(theta, theta)
    for a, b in zip(whole[0], some[0], strict=True):
        assert (a[chosen] == b).all()
    assert (whole[1] == some[1]).all() and (whole[2] == some[2]).all()
    assert hand.part(np.ones(4, dtype=bool)) is hand


def test_a_finger_without_contact_need_not_follow_a_move(tmp_path):
    plant = Plant(scenario_of(tmp_path, 4, 0.1, {}).plant)
    contacts, fewer, hand = plant.state.contacts, without_first(plant), plant.hand
    pose = AuxiliaryPose(contacts.centroid, np.eye(3))
    for shift, fits in ((0.01, True), (3.0, False)):
        target = Target(pose.position + [0.0, 0.0, shift], np.eye(3))
        try:
            check_reach(hand, plant.state.theta, fewer, pose, target)
            found = ""
        except PoseError as error:
            found = str(error)
        assert (found == "") == fits and "f1 " not in found


def test_closing_fingers_search_until_they_touch_or_have_gone_all_the_way(tmp_path):
    plant = Plant(scenario_of(tmp_path, 4, 0.1, {}).plant)
    contacts, fewer, hand = plant.state.contacts, without_first(plant), plant.hand
    fingers = Regrasp(RegraspConfig(), hand)
    fingers.leave(plant.state.theta, contacts)
    fingers.close()
    assert fingers.searches(fewer) and not fingers.searches(contacts)
    for _ in range(11):  # 22 mm
        fingers.posture(fewer, 0.1)
    assert not fingers.searches(fewer)


def test_a_finger_that_returns_leaves_the_others_their_posture(tmp_path):
    law = {"name": "grip", "integral": {"k_p": 0.0, "k_o": 0.0}, "observer": {"time": 0.0}}
    changes = {f"manipulation_controller.law.{name}": value for name, value in law.items()}
    changes |= {"tactile_sensor.axes": "normal", "slip_regulator.mode": "user"}
    changes |= {"force_optimizer.cones": False, "plant.encoder.bits": 0}
    loop = ClosedLoop(scenario_of(tmp_path, 4, 0.1, changes))
    theta, contacts = loop.state.theta, loop.state.contacts

    def step(tick, away, contacts):
        optimal = loop.optimizer.step(tick, contacts).forces
        forces = np.full((4, 3), np.nan)
        forces[:, 1] = 10.0 * optimal[:, 1]
        joints = Joints(theta + away, np.zeros(12))
        seen = contacts, optimal, 10.0, forces
        return loop.controller.step(tick * 1_000_000, joints, *seen).torque

    away = np.linspace(-0.004, 0.004, 12)
    still = step(0, 0.0, contacts), step(1, 0.0, contacts)
    before = step(2, away, contacts) - still[1]
    step(3, away, without_first(loop))
    after, of_first = step(4, away, contacts) - still[1], loop.controller.hand.moves[0]
    # The contacts count as newly measured, which turns the internal forces a little.
    np.testing.assert_allclose(after[~of_first], before[~of_first], atol=0.02)
    assert np.abs(after[of_first]).max() < 0.02 * np.abs(before[of_first]).max()
