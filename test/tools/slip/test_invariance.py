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
    "plant.disturbances": [{"kind": "step", "start": 0.03, "force": [1.0, 2.0, -8.0]}],
}
EXACTLY = rotation_from_vector([0.0, -0.5 * np.pi, 0.0])
WAYS = dict(orientations(1, seed=3))


@pytest.fixture(scope="module")
def straight():
    """Return the run of a hand that is not turned."""
    return run_turned("pull", np.eye(3), NOISELESS)


@pytest.mark.parametrize("way", [name for name in WAYS if name != "none"])
def test_a_turned_hand_does_the_same(straight, way):
    """Also with a contact normal along palm z, where the contact frames flip.

    The regulator agrees to rounding (test_regulator); the plant's contacts are solved in contact
    frames, and a flip costs up to 3 % of k_f.
    """
    record = run_turned("pull", WAYS[way], NOISELESS)
    np.testing.assert_array_equal(record.grip, straight.grip)
    np.testing.assert_allclose(record.grasp_force, straight.grasp_force, rtol=0.05)
    np.testing.assert_allclose(record.friction, straight.friction, rtol=1e-3)
    np.testing.assert_allclose(record.theta, straight.theta, atol=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_a_grasp_whose_plane_stands_upright_is_kept_as_it_is_for_any_noise(seed):
    """There noise decides on which side of the plane r_z is."""
    record = run_turned("human_hold", EXACTLY, {"duration": 0.3, "seed": seed})
    start, end = record.object_quaternion[[0, -1]]
    assert abs(start @ end) > np.cos(0.5 * 0.03)
