# SPDX-License-Identifier: Apache-2.0
"""A run does not depend on how hand, object, gravity and loads lie in the palm frame."""

import numpy as np
import pytest

from studies.invariance import orientations, run_turned
from tactile_hand_ros.rotations import rotation_from_vector

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
def straight(request):
    """Return the run of a hand that is not turned."""
    return request.param, run_turned(request.param, np.eye(3), NOISELESS)


@pytest.mark.parametrize("way", [name for name in WAYS if name != "none"])
def test_a_turned_hand_does_the_same(straight, way):
    """Also with a contact normal along palm z, where the contact frames flip."""
    name, expected = straight
    record = run_turned(name, WAYS[way], NOISELESS)
    np.testing.assert_array_equal(record.grip, expected.grip)
    np.testing.assert_allclose(record.grasp_force, expected.grasp_force, rtol=1e-9)
    np.testing.assert_allclose(record.friction, expected.friction, rtol=1e-9)
    np.testing.assert_allclose(record.theta, expected.theta, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_grasp_whose_plane_stands_upright_is_kept_as_it_is_for_any_noise(seed):
    """There noise decides on which side of the plane r_z is."""
    record = run_turned("human_hold", EXACTLY, {"duration": 0.3, "seed": seed})
    start, end = record.object_quaternion[[0, -1]]
    assert abs(start @ end) > np.cos(0.5 * 0.03)
