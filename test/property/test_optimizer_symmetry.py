# SPDX-License-Identifier: Apache-2.0
"""f* inside the cones: the same however a grasp lies in the palm, and in any order of fingers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactile_hand_ros.control.contact import Contacts, contact_frame
from tactile_hand_ros.control.loads import CarriedLoad, split
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig


def grasp(seed):
    """Return points, normals and forces in palm axes of 3 to 5 fingers around an object, and mu."""
    random = np.random.default_rng(seed)
    k, gaps = int(random.integers(3, 6)), np.array([np.inf])
    while gaps.max() > 2.6:  # else the normals cannot balance
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, k))
        gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    points = np.stack([np.cos(angles), np.sin(angles), 0.2 * random.normal(size=k)], axis=1)
    normals = -points / np.linalg.norm(points, axis=1)[:, None] + 0.2 * random.normal(size=(k, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    forces = 2.0 * normals + 0.7 * random.normal(size=(k, 3))
    return 0.03 * points, normals, forces, random.uniform(0.3, 0.8, k)


def shaped_forces(points, normals, forces, friction):
    """Return f* in palm axes after five ticks with a growing load, and whether cones shaped it."""
    config = ForceOptimizerConfig(cones=True, minimum_normal=0.02)
    optimizer = ForceOptimizer(config, len(points))
    frames = np.array([contact_frame(normal) for normal in normals])
    contacts = Contacts(points, frames)
    for tick in range(5):
        parts = split(points, normals, (1.0 + 0.1 * tick) * forces)
        load = np.einsum("kji,kj->ki", frames, parts.load)
        carried = CarriedLoad(load, 0.7 * friction, np.full(len(points), 0.1))
        optimal = optimizer.step(2_000_000 * tick, contacts, carried, parts.grasp_force)
    return np.einsum("kij,kj->ki", frames, optimal.forces), optimal.shaped


@pytest.mark.parametrize("seed", range(12))
def test_turned_grasps_get_turned_forces(seed):
    points, normals, forces, friction = grasp(seed)
    expected, shaped = shaped_forces(points, normals, forces, friction)
    assert shaped
    onto_z = Rotation.align_vectors([[0.0, 0.0, 1.0]], normals[:1])[0]  # no tangent follows palm z
    for turn in (onto_z, Rotation.random(random_state=seed)):
        found, _ = shaped_forces(*map(turn.apply, (points, normals, forces)), friction)
        np.testing.assert_allclose(found, turn.apply(expected), atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_the_order_of_the_fingers_does_not_matter(seed):
    points, normals, forces, friction = grasp(seed)
    expected, _ = shaped_forces(points, normals, forces, friction)
    order = np.random.default_rng(seed).permutation(len(points))
    found, _ = shaped_forces(points[order], normals[order], forces[order], friction[order])
    np.testing.assert_allclose(found, expected[order], atol=1e-9)
