# SPDX-License-Identifier: Apache-2.0
"""Impossible scenarios are reported before the start, in one sentence."""

import warnings
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from support.hands import changed, posture_for, write_hand

from tactile_hand_ros.errors import (
    CollinearContactsError,
    ConfigurationError,
    GraspError,
    HandModelError,
    ObjectModelError,
    PoseError,
    TactileHandError,
)
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.solid import Solid


def check(**changes):
    names = {key.replace("__", "."): value for key, value in changes.items()}
    check_scenario(load_scenario("paper", names))


LAW = "manipulation_controller__law__name"
AUTOMATIC = {LAW: "contact", "slip_regulator__mode": "auto"}


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        (AUTOMATIC, ConfigurationError, r"'contact' multiplies the .* by a distance.*mode to user"),
        ({"tactile_sensor__axes": "normal"}, ConfigurationError, r"forces in three axes.*to grip"),
        # With the targets of `paper`, and with its gains.
        ({"manipulation_controller__law": {"name": "grip"}}, PoseError, r"'grip' .*moves no obj"),
        ({LAW: "grip"}, ConfigurationError, r"'grip' controls no pose.*set k_p, k_o, damping"),
        ({"layout": "four_faces"}, HandModelError, r"no layout 'four_faces'.*three_faces, pinch"),
        ({"plant__object__size": [0.2, 0.2, 0.2]}, GraspError, r"finger_1 starts 30.2 mm away"),
        ({"plant__object__size": [0.3] * 3}, ObjectModelError, r"finger_1 starts 19.8 mm inside"),
        ({"targets": [{"position": [0.0, 0.0, 3.0]}]}, PoseError, r"3.000\) m is out of reach"),
        ({"plant__initial_joints": [3.2, 0.0, 1.5]}, ConfigurationError, r"3.2 rad of .*, -3.14"),
        ({"force_optimizer__weights": [1.0] * 4}, ConfigurationError, r"3 or 9 positive numbers"),
    ],
)
def test_what_cannot_work_is_refused_in_one_sentence(changes, error, message):
    with pytest.raises(error, match=message) as caught:
        check(**changes)
    assert isinstance(caught.value, TactileHandError) and "\n" not in str(caught.value)


def touching(folder, tips, **plant):
    """Return the changes for a hand that touches an object with its tips at given places."""
    path = write_hand(folder, [3, 3, 3])
    changes = {"hand": str(path), "layout": "", "targets": []}
    theta = posture_for(Hand.load(str(path)), np.array(tips))
    changes["plant__initial_joints"] = theta.tolist()
    return {**changes, **{f"plant__object__{key}": value for key, value in plant.items()}}


def test_normals_that_cannot_balance_are_refused(tmp_path):
    """All fingers are under a plate: they only push up, and nothing pushes down."""
    bearings = 2.0 * np.pi * np.arange(3) / 3
    tips = np.stack([0.1 * np.cos(bearings), 0.1 * np.sin(bearings), np.full(3, 0.3)], axis=1)
    plate = {"size": [0.4, 0.4, 0.1], "position": [0.0, 0.0, 0.3 + 0.02 + 0.05]}
    with pytest.raises(GraspError, match="no pushing forces at these contacts balance"):
        check(**touching(tmp_path, tips, **plate))


def test_fingers_on_a_line_are_refused(tmp_path):
    box = {"size": [0.2, 0.2, 0.2], "position": [0.0, 0.0, 0.3]}
    spread = [[0.12, 0.0, 0.3], [-0.12, 0.04, 0.3], [-0.12, -0.04, 0.3]]
    check(**touching(tmp_path, spread, **box))
    row = [[-0.12, 0.08, 0.3], [-0.12, 0.0, 0.3], [-0.12, -0.08, 0.3]]
    with pytest.raises(CollinearContactsError, match=r"lie on one line \(A7\)"):
        check(**touching(tmp_path, row, **box))


OWN = """
from tactile_hand_ros.control.laws import OptimalLaw
from tactile_hand_ros.errors import GraspError

class MyLaw(OptimalLaw):
    def drive(self, wrench):
        {body}
"""


@pytest.mark.parametrize(
    ("body", "error", "message"),
    [
        ("raise GraspError('not with this grasp')", GraspError, "^not with this grasp$"),
        ("return wrench", ConfigurationError, r"from drive\(wrench\); expected an array of 9 fin"),
        ("return list(super().drive(wrench))", ConfigurationError, "expected an array of 9"),
        ("return super().drive(wrench) / (wrench[5] - wrench[0])", ConfigurationError, "finite"),
    ],
)
def test_a_law_of_the_user_s_own_is_asked_for_its_drive_too(tmp_path, body, error, message):
    (tmp_path / "driving_law.py").write_text(OWN.format(body=body))
    (tmp_path / "mine.yaml").write_text("extends: paper\nlaw: driving_law:MyLaw\n")
    with np.errstate(all="ignore"), pytest.raises(error, match=message):
        check_scenario(load_scenario(str(tmp_path / "mine.yaml")))


@pytest.mark.parametrize(
    ("gains", "reason"),
    [
        ({"damping": 0.042}, ""),  # in the plant, 0.035 holds the cube and 0.06 throws it away
        ({"damping": 0.043}, "damping = 0.043 is unstable at 1000 Hz.*at most 0.04"),
        ({"damping": 0.012, "k_o": 1.0}, ""),
        ({"damping": 0.012, "k_o": 6.0}, "k_o = 6 is unstable at 1000 Hz.*at most [1-5]"),
    ],
)
def test_gains_that_throw_the_object_away_are_refused_with_what_would_do(gains, reason):
    """By the delay of a tick, a damping is too large, or a stiffness takes all of it."""
    chosen = load_scenario("human_hold", {f"law.{name}": value for name, value in gains.items()})
    with pytest.raises(ConfigurationError, match=reason) if reason else nullcontext():
        check_scenario(chosen)


@pytest.mark.parametrize(("depth", "reported"), [(0.02, []), (0.13, ["+14.3 %"])])
def test_a_mesh_whose_hull_is_another_body_is_reported(tmp_path, depth, reported):
    """A cube with a dent of 3/4 x 1/3 depth in the face that no finger touches."""
    cube = trimesh.creation.box((0.2604, 0.2604, 0.2604)).subdivide()
    cube.vertices[np.linalg.norm(cube.vertices - [0.0, 0.0, 0.1302], axis=1).argmin(), 2] -= depth
    cube.export(tmp_path / "dented.stl")
    place = [0.0, 0.0, 0.4098 + float(cube.center_mass[2])]
    body = {"mesh": str(tmp_path / "dented.stl"), "inertia": [], "position": place}
    scenario = load_scenario("paper", {f"plant.object.{key}": body[key] for key in body})
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        check_scenario(scenario)
    texts = [text for each in seen if "convex hull" in (text := str(each.message))]
    assert len(texts) == len(reported)
    assert all(part in text for part, text in zip(reported, texts, strict=True))


def test_links_inside_the_object_are_named_and_tips_are_not(tmp_path):
    box = '<collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>'
    shapes = [(f'<link name="{n}"/>', f'<link name="{n}">{box}') for n in ("f2_base", "f1_tip")]
    hand = changed(write_hand(tmp_path, [3, 3, 3]), *shapes)
    theta, level = np.full(9, 0.4), np.eye(3)
    links = LinkCollisions(hand, Solid.box(np.array([0.1, 0.04, 0.04])))
    base, tip = hand.bases[1], hand.tip_positions(theta)[0]
    # The two overlap along x; turned by 90 degrees, the long box is too short.
    beside = base + np.array([0.055, 0.0, 0.0])
    assert links.touching(theta, beside, level) == ["f2_base"]
    assert links.touching(theta, beside, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])) == []
    assert links.touching(theta, base + np.array([0.065, 0.0, 0.0]), level) == []
    assert links.touching(theta, tip, level) == []
    without_shapes = LinkCollisions(Hand.load("human"), Solid.box(np.full(3, 0.2)))
    assert without_shapes.touching(np.zeros(9), np.zeros(3), level) == []
