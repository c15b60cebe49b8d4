# SPDX-License-Identifier: Apache-2.0
"""Hands with two fingers, or with fewer joints than a contact force has components."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.grasps import contacts_at
from support.hands import prism_grasp

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.grasp import VirtualFrame, grasp_map, wrench_forces
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    Status,
)
from tactile_hand_ros.control.stability import buckling_rate, fitted_gains, motions_of_object
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

POINTS = np.array([[0.03, 0.01, 0.1], [-0.02, -0.01, 0.12]])
ALONG = (POINTS[0] - POINTS[1]) / np.linalg.norm(POINTS[0] - POINTS[1])


def opposed(points, lean=0.0):
    """Two contacts that face each other, the first leaning by an angle about its own z axis."""
    along = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
    axis = np.cross(along, [0.0, 0.0, 1.0])
    normal = rotation_from_vector(lean * axis / np.linalg.norm(axis)) @ along
    return contacts_at(points, np.array([normal, -along]))


def test_two_contacts_press_along_their_line():
    contacts = opposed(POINTS, 0.3)
    optimal = ForceOptimizer(ForceOptimizerConfig(cones=True), 2).step(0, contacts)
    assert optimal.ok and optimal.forces[:, 1].sum() == pytest.approx(1.0)
    first, second = np.einsum("kij,kj->ki", contacts.rotations, optimal.forces)
    assert_allclose(first, -second, atol=1e-12)
    assert_allclose(np.cross(first, POINTS[1] - POINTS[0]), 0.0, atol=1e-12)
    assert first @ (POINTS[1] - POINTS[0]) > 0.0
    assert np.hypot(*optimal.forces[0, [0, 2]]) / optimal.forces[0, 1] == pytest.approx(np.tan(0.3))
    away = ForceOptimizer(ForceOptimizerConfig(), 2).solve(opposed(POINTS, 2.0))
    assert away.status is Status.UNBALANCED


def test_two_contacts_carry_all_of_a_wrench_but_the_turn_about_their_line():
    wrench = np.array([1.0, -2.0, 3.0, 0.02, 0.05, -0.04])
    forces = wrench_forces(POINTS, wrench)
    frames = np.tile(np.eye(3), (2, 1, 1))
    got = grasp_map(POINTS - POINTS.mean(axis=0), frames) @ forces.ravel()
    assert_allclose(got[:3], wrench[:3], atol=1e-12)
    assert_allclose(got[3:], wrench[3:] - ALONG * (ALONG @ wrench[3:]), atol=1e-6)


def test_the_frame_of_two_contacts_turns_with_their_line_and_not_about_it():
    frame = VirtualFrame()
    start = frame.orientation(POINTS)
    turn = np.eye(3)
    for _ in range(50):
        small = rotation_from_vector(np.array([0.05, -0.02, 0.04]))
        turn = small @ turn
        now = frame.orientation(POINTS @ turn.T)
    assert_allclose(start[:, 0], ALONG)
    assert_allclose(now[:, 0], turn @ ALONG, atol=1e-12)
    assert_allclose(now.T @ now, np.eye(3), atol=1e-12)
    assert np.linalg.det(now) == pytest.approx(1.0)
    assert_allclose(VirtualFrame().orientation(POINTS), start)


def few_joints(tmp_path):
    """A scenario in which a hand of two joints a finger holds a prism between its tips."""
    gains = {f"manipulation_controller.law.{name}": 0.0 for name in ("k_p", "k_o", "damping")}
    body = {"plant.object.inertia": [], "plant.object.mass": 0.3, "plant.object.friction": 1.0}
    pull = {"kind": "step", "start": 0.02, "force": [0.2, 0.1, -0.5]}
    changes = {**gains, **body, "targets": [], "duration": 0.5, "plant.disturbances": [pull]}
    return load_scenario("paper", prism_grasp(tmp_path, [2, 2, 2]) | changes)


def test_two_joint_fingers_hold_and_refuse_moves_that_they_cannot_make(tmp_path):
    loop = ClosedLoop(few_joints(tmp_path))
    record = loop.run()
    moved = np.linalg.norm(record.object_position - record.object_position[0], axis=1)
    assert moved.max() < 1e-3 and record.true_slid[-1].max() < 1e-4
    assert loop.controller.warning == ""
    pose = loop.controller.targets.target
    turned = rotation_from_vector(np.array([0.0, 0.0, 0.2])) @ pose.orientation
    with pytest.raises(PoseError):
        loop.controller.targets.command(pose._replace(orientation=turned))


def test_the_same_parameters_again_move_nothing(tmp_path, monkeypatch):
    """Also where the hand keeps its posture, since its joints move the object in few directions."""
    monkeypatch.setattr("tactile_hand_ros.control.controller.FEWEST_MOTIONS", 4)
    loop, other = (ClosedLoop(few_joints(tmp_path)) for _ in range(2))
    for theta in other.run(100).theta:
        np.testing.assert_array_equal(loop.run(1).theta[0], theta)
        loop.controller.configure(loop.controller.config)


def test_gains_fit_motions_that_exist_only(tmp_path):
    """Nine constraints and six joints leave three motions: the others have no stiffness."""
    plant = Plant(few_joints(tmp_path).plant)
    contacts, theta = plant.state.contacts, plant.state.theta
    forces = contacts.centroid - contacts.positions
    gains = fitted_gains(plant.hand, theta, contacts, forces, 0.002, 0.01, 0.1)
    damping, stiffness = gains.at(2.0, 1.0)
    assert motions_of_object(plant.hand, theta, contacts) == 3
    assert np.isfinite(damping).all() and np.isfinite(gains.at(0.0, 0.0)[1]).all()
    assert np.linalg.matrix_rank(stiffness, tol=1e-9 * np.abs(stiffness).max()) == 3
    assert np.linalg.eigvalsh(stiffness * np.repeat([1.0, 2.0], 3))[0] > -1e-9
    assert buckling_rate(plant.hand, theta, contacts, forces) >= 0.0
