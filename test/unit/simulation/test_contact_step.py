# SPDX-License-Identifier: Apache-2.0
"""One step on arrays: rotations, friction and sliding per finger, gaps, and visible contacts."""

import numpy as np
import pytest
from support.plants import jacobian, plant

from tactile_hand_ros.control.contact import contact_frame
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.simulation.contact_step import (
    TOUCH,
    World,
    at_rest,
    carried,
    half_step,
    observed,
    step,
)
from tactile_hand_ros.simulation.solid import Solid

H = 1e-3
MU = np.array([0.1, 0.6, 0.3])
FAR = {"object__position": (0.0, 0.0, 9.0)}
ONE = {"object__size": (0.24, 0.2604, 0.2604)}  # only finger 3 touches


class Scene:
    """Hand and object of a plant at rest, stepped with chosen velocities."""

    def __init__(self, friction=MU, **values):
        world = plant(H, **values)
        state, c = world.state, world.config.object
        self.hand, self.contacts, self.jacobian = world.hand, state.contacts, jacobian(world, state)
        self.world = World(self.hand.radii, c.solid().shape, c.mass, c.inertia_about(c.solid()))
        self.now = at_rest(state.theta, state.position, state.rotation, 3)
        self.torque, self.friction = np.zeros(9), friction

    def step(self, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), rates=np.zeros(9)):
        """Take a step with chosen velocities, equal to those before it."""
        v = np.concatenate([rates, velocity, spin])
        self.now = self.now._replace(velocities=v, before=v)
        return self.follow()

    def follow(self):
        """Take the next step."""
        theta, ahead = half_step(H, self.now)
        terms = self.hand.dynamics(theta, ahead[:9])
        acting = self.friction, terms, self.torque, np.zeros(6)
        self.now = step(H, self.now, self.world, *acting)
        return self.now


def test_a_matrix_that_has_drifted_comes_back_to_the_nearest_rotation():
    """Newton's iteration: an error E of R = Q (I + E) becomes -3/2 E^2 - 1/2 E^3, and Q stays."""
    scene = Scene(**FAR)
    nearest = rotation_from_vector([0.7, -0.4, 1.1])
    error = 1e-3 * np.array([[1.0, 0.5, -0.7], [0.5, -2.0, 0.3], [-0.7, 0.3, 1.5]])
    scene.now = scene.now._replace(rotation=nearest @ (np.eye(3) + error))
    expected = nearest @ (np.eye(3) - 1.5 * error @ error - 0.5 * error @ error @ error)
    np.testing.assert_allclose(scene.step().rotation, expected, atol=1e-14)
    scene.step()
    np.testing.assert_allclose(scene.step().rotation, nearest, atol=1e-14)


def test_each_finger_rubs_with_its_own_friction_and_slides_its_own_way():
    """A heavy object is drawn through the fingers: each slips along both axes of its face."""
    scene = Scene(object__mass=100.0, object__inertia=(9.0, 9.0, 9.0))
    pushes = np.array([[30.0], [50.0], [40.0]]) * scene.contacts.normals
    scene.torque = scene.jacobian.T @ pushes.ravel()
    before, start = np.array([1e-3, 3e-3, 2e-3]), scene.now.position
    scene.now = scene.now._replace(slid=before)
    after = scene.step(np.array([0.06, 0.07, -0.12]), np.array([0.2, 0.1, -0.3]))
    normal, rubbing = after.impulses[:, 1], after.impulses[:, [0, 2]]
    assert (normal > 1e-4).all()
    speeds = np.hypot(*after.sliding.T)
    assert np.abs(after.sliding).min() > 5e-3 and np.abs(np.diff(speeds)).min() > 5e-3
    against = -(MU * normal / speeds)[:, None] * after.sliding
    np.testing.assert_allclose(rubbing, against, rtol=1e-6, atol=1e-12)
    # Sliding is the motion of the object's point relative to the tip's, in the contact frame.
    points = scene.contacts.positions
    body = after.velocities[9:12] + np.cross(after.velocities[12:], points - start)
    tips = (scene.jacobian @ after.velocities[:9]).reshape(3, 3)
    seen = np.einsum("kji,kj->ki", scene.contacts.rotations, body - tips)
    np.testing.assert_allclose(after.sliding, seen[:, [0, 2]], atol=2e-4)
    # From middle to middle of two steps, the positions move by one step of these velocities.
    np.testing.assert_array_equal(after.slid, before)
    np.testing.assert_allclose(scene.follow().slid - before, H * speeds, rtol=5e-3)
    np.testing.assert_array_equal(before, [1e-3, 3e-3, 2e-3])


def test_a_vector_is_carried_to_where_the_tangents_of_a_contact_point_now():
    """Frames that flip about the normal within a step yield the same force."""
    vector, normal = np.array([0.3, 2.0, -0.4]), np.array([2e-3, -1e-3, 1.0])
    normal /= np.linalg.norm(normal)
    near = normal + [-4e-3, 3e-3, 0.0]
    near /= np.linalg.norm(near)
    then, now = contact_frame(normal), contact_frame(near)
    assert np.linalg.norm(now - then) > 1.0
    np.testing.assert_allclose(now @ carried(now.T, then.T, vector), then @ vector, atol=2e-2)


@pytest.mark.parametrize(
    ("gap", "speed", "opening"),
    [
        (6e-4, 1.0, -0.1),  # approaches: closes the rest of the gap at the middle of the step
        (-2e-5, -0.004, 0.004),  # was too deep, already separates
        (-2e-5, 0.0, 0.004),  # was too deep: a fifth of it is removed
        (-1e-3, 0.0, 0.005),  # the same, up to the maximum speed
        (6e-4, 0.2, -0.2),  # does not approach yet: no contact
        (-1e-4, -1.0, 1.0),  # separates quickly
    ],
)
def test_a_gap_is_closed_in_one_step_and_a_penetration_in_five(gap, speed, opening):
    """The gap is that of the middle of a step, whose path leads to the middle of the next."""
    scene = Scene(object__mass=0.5, object__inertia=(1e-3, 2e-3, 3e-3), **ONE)
    normal = scene.contacts.normals[2]
    start = scene.now.position + gap * normal
    scene.now = scene.now._replace(position=start)
    # It also slides, which does not affect the gap.
    after = scene.step(-speed * normal + [0.07, 0.0, 0.04])
    arm = scene.contacts.positions[2] - (start - 0.5 * H * speed * normal)
    velocity, spin = after.velocities[9:12], after.velocities[12:]
    tip = scene.jacobian[6:] @ after.velocities[:9]
    assert normal @ (velocity + np.cross(spin, arm) - tip) == pytest.approx(opening, abs=2e-4)
    assert (after.impulses[2, 1] > 0.0) == (opening not in (-speed, 1.0))
    assert after.sliding[2].any() == (after.impulses[2, 1] > 0.0)


def without_contacts(scene, v):
    """Return M in the middle of a step, shape (15, 15), and the velocities without contacts.

    v are those at the start and of the step before, shape (15,).
    """
    terms = scene.hand.dynamics(scene.now.theta + 0.5 * H * v[:9], v[:9])
    turned = rotation_from_vector(0.5 * H * v[12:]) @ scene.now.rotation
    matrix = np.zeros((15, 15))
    matrix[:9, :9] = terms.inertia
    matrix[9:12, 9:12] = scene.world.mass * np.eye(3)
    matrix[12:, 12:] = turned @ scene.world.inertia @ turned.T
    gyroscopic = np.cross(v[12:], matrix[12:, 12:] @ v[12:])
    forces = np.concatenate([-terms.bias, np.zeros(3), -gyroscopic])
    return matrix, v + H * np.linalg.solve(matrix, forces)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 100.0])
@pytest.mark.parametrize("mass", [0.01, 10.0])
def test_impacts_take_energy_and_do_not_rebound(friction, mass):
    """Fingers and object fly about at random until they collide."""
    random, strikes = np.random.default_rng(int(1e3 * mass + friction)), 0
    scene = Scene(np.full(3, friction), object__mass=mass)
    start = scene.now
    for _ in range(20):
        speed = 10.0 ** random.uniform(-1.0, -0.3)
        inertia = np.diag(0.01 * mass * random.uniform(1.0, 1.8, 3))
        smaller = Solid.box(0.2604 - random.uniform(2e-3, 3e-3, 3)).shape
        scene.world = scene.world._replace(shape=smaller, inertia=inertia)
        scene.now = start
        end = 0.7 * speed * random.standard_normal(15)
        for _ in range(15):
            matrix, free = without_contacts(scene, end)
            after = scene.step(end[9:12], end[12:], end[:9])
            pushed, end = after.impulses[:, 1] > 0.0, after.velocities
            assert end @ matrix @ end <= (free @ matrix @ free) * (1.0 + 1e-12)
            if pushed.any():
                # Relative to the fingertips, the object does not separate after the impact.
                assert (after.rows @ end)[pushed, 1].max() < 1e-9
                strikes += 1
                break
    assert strikes > 5


def test_only_what_touches_or_is_pushed_is_seen():
    """A gap of a micrometer is no contact; a push counts even if rounding leaves a gap."""
    size, position = np.array([0.2, 0.3, 0.4]), np.array([0.05, -0.02, 0.4])
    rotation = rotation_from_vector([0.4, -0.3, 0.6])
    faces = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    gaps = np.array([1.01e-6, 0.99e-6, 1.01e-6, -2e-4, 1.5e-3, 1e-7])
    pushes = np.array([0.0, 0.0, 1e-9, 0.0, 0.0, 0.3])
    radii = np.array([0.06, 0.05, 0.04, 0.03, 0.02, 0.01])
    aside = 0.02 * np.roll(faces, 1, axis=1)
    on_face = 0.5 * size * faces + aside
    tips = position + (on_face + (radii + gaps)[:, None] * faces) @ rotation.T
    impulses = np.stack([np.full(6, 0.1), pushes, np.full(6, -0.1)], axis=1)
    shape = Solid.box(size).shape
    rows = np.zeros((6, 3, 6))
    rows[:, 0, 2], rows[:, 1, 1], rows[:, 2, 0] = 1.0, 1.0, -1.0
    now = at_rest(np.zeros(0), position, rotation, 6)._replace(impulses=impulses, rows=rows)
    points, frames, found, seen = observed(World(radii, shape, 1.0, np.eye(3)), now, tips)
    np.testing.assert_allclose(seen[:, 1], pushes)
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), np.linalg.norm(impulses, axis=1))
    np.testing.assert_allclose(found, gaps, atol=1e-12)
    seen = np.array([False, True, True, True, False, True])
    assert ((gaps > TOUCH) & (pushes == 0.0) == ~seen).all()
    np.testing.assert_array_equal(np.isfinite(points), np.outer(seen, [True] * 3))
    np.testing.assert_array_equal(np.isfinite(frames).all(axis=2), np.outer(seen, [True] * 3))
    np.testing.assert_allclose(frames[seen][:, :, 1], -(faces @ rotation.T)[seen], atol=1e-12)
    expected = position + (on_face + gaps[:, None] * faces) @ rotation.T
    np.testing.assert_allclose(points[seen], expected[seen], atol=1e-12)
