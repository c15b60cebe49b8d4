# SPDX-License-Identifier: Apache-2.0
"""Model errors: the true hand and gravity differ from the model, which interprets touch."""

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.contact import contact_frame
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_quaternion, rotation_from_vector
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.skin import CalibrationConfig, miscalibrated


def scenario(**errors: object) -> Scenario:
    """Return the scenario `gravity` with some errors."""
    return load_scenario("gravity", {f"calibration.{k}": v for k, v in errors.items()})


def test_without_errors_hand_and_model_are_one() -> None:
    plant = Plant(scenario().plant)
    assert CalibrationConfig().is_right
    assert plant.hand is plant.model


def test_larger_tips_touch_where_they_are_and_are_reported_where_the_model_is() -> None:
    made = scenario(tip_radii=1.1, link_lengths=1.03)
    plant = Plant(made.plant)
    state, known = plant.state, plant.model
    np.testing.assert_allclose(plant.hand.radii, 1.1 * known.radii)
    assert np.abs(state.gaps).max() < 1e-12
    true = state.touch
    errors = made.tactile_sensor.calibration
    seen = miscalibrated(errors, known, state.theta, true)
    normals = rotation_from_quaternion(true.quaternions)[:, :, 1]
    expected = known.tip_positions(state.theta) + known.radii[:, None] * normals
    np.testing.assert_allclose(seen.positions, expected, atol=1e-12)
    np.testing.assert_allclose(seen.forces, true.forces, atol=1e-12)
    assert np.linalg.norm(seen.positions - true.positions, axis=1).min() > 1e-3


def test_a_turned_skin_turns_normal_and_force_alike() -> None:
    """In the palm frame both rotate equally, as given in axes of the fingertip."""
    vector = np.array([0.05, -0.1, 0.08])
    made = ClosedLoop(scenario())
    made.run(40)
    state, hand = made.plant.state, made.plant.model
    true = state.touch
    errors = CalibrationConfig(skin_rotation=tuple(vector))
    seen = miscalibrated(errors, hand, state.theta, true)
    tips = hand.tip_rotations(state.theta)
    for i in range(hand.fingers):
        turn = tips[i] @ rotation_from_vector(vector) @ tips[i].T
        before = rotation_from_quaternion(true.quaternions[i])
        after = rotation_from_quaternion(seen.quaternions[i])
        np.testing.assert_allclose(after[:, 1], turn @ before[:, 1], atol=1e-12)
        np.testing.assert_allclose(after, contact_frame(after[:, 1]), atol=1e-12)
        force = after @ seen.forces[i]
        np.testing.assert_allclose(force, turn @ before @ true.forces[i], atol=1e-12)


def test_gravity_turns_for_object_and_links_and_not_for_the_controller() -> None:
    far = {"calibration.gravity_rotation": [0.5, 0.0, 0.0], "plant.object.position": [0, 0, 9]}
    turning = load_scenario("gravity", far)
    plant, gravity = Plant(turning.plant), np.array(turning.gravity)
    turned = rotation_from_vector(np.array([0.5, 0.0, 0.0])) @ gravity
    theta = plant.state.theta
    right = Hand.load("paper", gravity=turned).gravity_torque(theta)
    np.testing.assert_allclose(plant.hand.gravity_torque(theta), right, atol=1e-12)
    fallen = plant.advance(np.zeros(9)).velocity
    np.testing.assert_allclose(fallen, turned / turning.plant.rate, atol=1e-12)
    assert turning.manipulation_controller.gravity == tuple(gravity)
