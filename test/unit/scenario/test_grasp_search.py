# SPDX-License-Identifier: Apache-2.0
"""Grasps that a search finds are grasps: of shipped hands, mixed hands, coupled ones, any box."""

from functools import partial

import numpy as np
import pytest
import yaml
from support.hands import write_hand

from tactile_hand_ros.cli import main
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import hand_jacobian, in_palm, joint_torques
from tactile_hand_ros.control.grasp import check_joints, joint_margin, wrench_forces
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario import grasp_search
from tactile_hand_ros.scenario.grasp_search import expected_friction, scenario_values, search
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import ObjectConfig

DOWN = np.array([0.0, 0.0, -9.81])


def worth_of(grasp):
    return grasp.load * grasp.press * min(1.0, 4.0 * grasp.room) * min(1.0, 10.0 * grasp.lever)


@pytest.fixture(autouse=True)
def _few_starts(monkeypatch):
    monkeypatch.setattr(grasp_search, "STARTS", 8)


def scenario(tmp_path, values, **more):
    file = tmp_path / "found.yaml"
    file.write_text(yaml.safe_dump(values))
    return load_scenario(str(file), more)


def body_of(size, shape="box", mass=0.05):
    return ObjectConfig(shape=shape, size=size, mass=mass, friction=0.5)


@pytest.mark.parametrize(
    ("joints", "size", "more"),
    [
        ((), (0.04, 0.04, 0.04), {}),
        ((), (0.03, 0.05, 0.07), {}),
        ((3, 4, 3), (0.2, 0.2, 0.2), {}),
        ((4, 4, 4), (0.2, 0.2, 0.2), {"couplings": {"f1_joint_4": {"joint": "f1_joint_3"}}}),
        ((3, 3, 3, 3), (0.2, 0.2, 0.2), {}),
        ((4, 3, 3), (0.2, 0.2, 0.2), {"limits": {"f1_joint_4": {"lower": 0.0, "upper": 0.0}}}),
    ],
)
def test_what_is_found_touches_one_face_and_the_opposite_and_can_bear_its_load(
    tmp_path, joints, size, more
):
    name = str(write_hand(tmp_path, joints, **more)) if joints else "human"
    hand = Hand.load(name, gravity=DOWN)
    best, *others = search(hand, body_of(size))
    worth = [worth_of(grasp) for grasp in (best, *others)]
    assert worth == sorted(worth, reverse=True)
    plant = Plant(scenario(tmp_path, scenario_values(name, body_of(size), best)).plant)
    assert np.abs(plant.state.gaps).max() < 2e-4 and plant.state.contacts.all_touching
    inward = best.contacts.normals
    alone = [i for i in range(len(inward)) if (inward @ inward[i] < -0.999).sum() > 1]
    assert len(alone) == 1 and best.room >= 0.1 and np.linalg.norm(best.rotation) <= np.pi
    assert best.load == pytest.approx(best.grasp_force * (expected_friction(0.5) - best.friction))
    # Pulled from many sides at that load and grasp force, the weakest joint is at its limit.
    tips, points = hand.fingertips(best.theta), best.contacts.positions
    jacobian = hand_jacobian(tips, points, best.contacts.rotations)
    longest = np.linalg.norm(jacobian.reshape(-1, hand.joints), 2)
    assert joint_margin(jacobian) == pytest.approx(best.lever * longest) and best.lever > 0.02
    optimal = ForceOptimizer(ForceOptimizerConfig(weights=[10.0, 1.0, 10.0]), hand.fingers)
    pressing = in_palm(best.contacts.rotations, optimal.solve(best.contacts).forces, 1.0)
    ways = np.random.default_rng(0).standard_normal((2000, 3))
    ways *= best.load / np.linalg.norm(ways, axis=1)[:, None]
    spare = hand.effort_limits - np.abs(hand.gravity_torque(best.theta))
    pulls = (wrench_forces(points, wrench) for wrench in np.pad(ways, ((0, 0), (0, 3))))
    pushed = best.grasp_force * pressing
    used = np.array([joint_torques(tips, points, pushed + pull) for pull in pulls])
    assert 0.95 < (np.abs(used) / spare).max() <= 1.0 + 1e-9


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ("box", (0.04, 0.04, 0.04)),
        ("cylinder", (0.04, 0.04, 0.08)),
        ("sphere", (0.05, 0.05, 0.05)),
        ("capsule", (0.035, 0.035, 0.07)),
    ],
)
def test_a_found_grasp_holds_at_the_first_try_and_bears_a_pull(tmp_path, shape, size):
    """Under gravity, with gains from the hand.

    Rounding decides where the search ends and so which grasp is the best; one may be three times
    as stiff as another. A grasp that holds gives way in proportion to its load, the weight of 1 N
    and then the pull of 2 N, and comes back as the observer carries it; one that slips does not.
    """
    body = body_of(size, shape, 0.1)
    best = search(Hand.load("human", gravity=DOWN), body)[0]
    values = scenario_values("human", body, best)
    pull = [{"kind": "step", "start": 0.5, "force": [0.0, 0.0, -2.0]}]
    changes = {"duration": 1.5, "plant.disturbances": pull}
    record = ClosedLoop(scenario(tmp_path, values, **changes)).run()
    moved = np.linalg.norm(record.object_position - record.object_position[0], axis=1)
    sagged, pulled = moved[:500].max(), moved[500:].max()
    assert len(record) == 1501 and sagged < 0.004 and moved[-1] < pulled / 3.0
    assert pulled < 1.25 * sagged * 2.0 / (9.81 * body.mass)
    assert np.isfinite(record.true_positions).all() and record.true_slid[-1].max() < 1e-3


def test_two_fingers_hold_a_box_through_its_center(tmp_path):
    """They resist no turn about the line between them, so a box beside it would swing."""
    hand = Hand.load(str(write_hand(tmp_path, [2, 2])), gravity=DOWN)
    best = search(hand, body_of((0.2, 0.15, 0.3)))[0]
    one, other = best.contacts.positions - best.position
    along = (one - other) / np.linalg.norm(one - other)
    assert np.linalg.norm(np.cross(one, along)) < 2e-3


def test_a_grasp_whose_fingers_can_press_along_the_normals_comes_first(tmp_path, monkeypatch):
    """Fingers of two joints meet a ball also where they can hardly press it."""
    monkeypatch.setattr(grasp_search, "STARTS", 40)
    hand = Hand.load(str(write_hand(tmp_path, [3, 2, 2])), gravity=DOWN)
    found = search(hand, body_of((0.2, 0.2, 0.2), "sphere"))
    worth = [worth_of(grasp) for grasp in found]
    assert worth == sorted(worth, reverse=True) and min(grasp.press for grasp in found) < 0.9
    best = found[0]
    tips = hand.fingertips(best.theta).linear
    for jacobian, normal in zip(tips, best.contacts.normals, strict=True):
        speed = np.linalg.lstsq(jacobian, normal, rcond=1e-3)[0]
        assert np.linalg.norm(jacobian @ speed) >= best.press - 1e-6


def test_a_finger_that_cannot_press_where_it_touches_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(grasp_search, "_PRESS", 1.1)
    hand = Hand.load(str(write_hand(tmp_path, [2, 2])), gravity=DOWN)
    with pytest.raises(GraspError, match="most often f[12] cannot press where it touches"):
        search(hand, body_of((0.2, 0.15, 0.3)))


def test_a_straight_hand_is_no_grasp(monkeypatch):
    """It would be refused when the run starts."""
    monkeypatch.setattr(grasp_search, "check_joints", partial(check_joints, minimum=1.0))
    with pytest.raises(GraspError, match="most often contacts are on one line, or the hand is sin"):
        search(Hand.load("human", gravity=DOWN), body_of((0.04, 0.04, 0.04)))


def test_without_a_grasp_it_says_why():
    hand = Hand.load("human", gravity=DOWN)
    with pytest.raises(GraspError, match="box of 500 x 500 x 500 mm .* does not reach its side"):
        search(hand, body_of((0.5, 0.5, 0.5)))


def test_the_command_writes_a_scenario_that_can_run_and_a_picture(tmp_path, capsys):
    assert main(["grasp", "human", "0.04", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    file = tmp_path / "human_40mm.yaml"
    assert "with 0.2 kg, it bears pulls of up to " in printed
    assert f"next: tactile-hand run {file}" in printed and file.with_suffix(".png").is_file()
    record = ClosedLoop(load_scenario(str(file), {"duration": 0.2})).run()
    assert np.isfinite(record.true_positions).all()
    words = ["human", "0.04", "0.08", "--shape", "cylinder"]
    assert main(["grasp", *words, "--out", str(tmp_path)]) == 0
    body = load_scenario(str(tmp_path / "human_cylinder_40x40x80mm.yaml")).plant.object
    assert (body.shape, body.size) == ("cylinder", (0.04, 0.04, 0.08))
    for words, message in (
        (["human"], "expected one or three positive lengths"),
        (["human", "0.04", "0.03"], "expected one or three positive lengths"),
        (["human", "0.04", "--shape", "cone"], "shape is 'cone', but should be 'box', 'cylinder'"),
        (["human", "nan"], "expected one or three positive lengths"),
        (["human", "0.04", "--mass", "50"], "a box of 50 kg is too heavy: the best grasp carries"),
    ):
        assert main(["grasp", *words, "--out", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err
