# SPDX-License-Identifier: Apache-2.0
"""A run does not depend on how the hand lies, its size, or the order of its fingers."""

import numpy as np
import pytest

from studies.invariance import orientations, reordered, resized, turned
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.run.events import alarm_count

NOISELESS = {
    "duration": 0.08,
    "tactile_sensor.force_noise": 0.0,
    "tactile_sensor.location_noise": 0.0,
    "tactile_sensor.bias_drift": 0.0,
    "tactile_sensor.vibration.gain": 0.0,
    "plant.encoder.bits": 0,
    "plant.disturbances": [{"kind": "step", "start": 0.03, "force": [1.0, 2.0, -8.0]}],
}
EXACTLY = rotation_from_vector([0.0, -0.5 * np.pi, 0.0])
WAYS = dict(orientations(1, seed=3))


@pytest.fixture(scope="module", params=["pull", "human_pull"])
def straight(request, tmp_path_factory):
    """Return the run of a hand that is not turned."""
    hand = turned(request.param, np.eye(3), tmp_path_factory.mktemp("hand"), NOISELESS)
    return request.param, ClosedLoop(hand).run()


@pytest.mark.parametrize("way", [name for name in WAYS if name != "none"])
def test_a_turned_hand_does_the_same(straight, way, tmp_path):
    """Also with a contact normal along palm z, where the contact frames flip."""
    name, expected = straight
    record = ClosedLoop(turned(name, WAYS[way], tmp_path, NOISELESS)).run()
    np.testing.assert_array_equal(record.grip, expected.grip)
    np.testing.assert_allclose(record.grasp_force, expected.grasp_force, rtol=1e-9)
    np.testing.assert_allclose(record.friction, expected.friction, rtol=1e-9)
    np.testing.assert_allclose(record.theta, expected.theta, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_grasp_whose_plane_stands_upright_is_kept_as_it_is_for_any_noise(seed, tmp_path):
    """There noise decides on which side of the plane r_z is."""
    changes = {"duration": 0.3, "seed": seed}
    record = ClosedLoop(turned("human_hold", EXACTLY, tmp_path, changes)).run()
    start, end = record.object_quaternion[[0, -1]]
    assert abs(start @ end) > np.cos(0.5 * 0.03)


@pytest.mark.parametrize("order", [(1, 2, 0), (0, 2, 1)])
def test_the_order_of_the_fingers_changes_no_force(straight, order, tmp_path):
    """The virtual frame follows two contacts more than the third, so the posture differs a bit."""
    name, expected = straight
    record = ClosedLoop(reordered(name, order, tmp_path, NOISELESS)).run()
    fingers = list(order)
    np.testing.assert_array_equal(record.grip, expected.grip[:, fingers])
    np.testing.assert_allclose(record.grasp_force, expected.grasp_force, rtol=1e-3)
    np.testing.assert_allclose(record.friction, expected.friction[:, fingers], rtol=1e-3)
    np.testing.assert_allclose(record.theta, expected.theta, atol=1e-3)


@pytest.mark.parametrize(("link", "mass"), [(0.25, 0.005), (0.01, 0.3)])
def test_a_hand_of_a_quarter_of_the_size_holds_what_is_light_and_heavy(link, mass, tmp_path):
    record = ClosedLoop(resized("hold", 0.25, link, mass, tmp_path, {"duration": 2.0})).run()
    assert alarm_count(record) == 0
    assert np.nanmax(record.true_slid) < 1e-5 and np.isfinite(record.true_positions[-1]).all()
