# SPDX-License-Identifier: Apache-2.0
"""One step on arrays: rotations, friction and sliding of each finger, gaps, and what is seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.plants import jacobian, plant

from tactile_hand_ros.control.contact import contact_frame
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.simulation.contact_step import (
    TOUCH,
    Body,
    HandTerms,
    _since,
    carried,
    half_step,
    no_past,
    observed,
    step,
)
from tactile_hand_ros.simulation.solid import ConvexPolyhedron

H = 1e-3
MU = np.array([0.1, 0.6, 0.3])
FAR = {"object__position": (0.0, 0.0, 9.0)}
ONE = {"object__size": (0.24, 0.2604, 0.2604)}  # only finger 3 touches


class Scene:
    """Hand and object of a plant at rest, of which one step is taken with chosen velocities."""

    def __init__(self, **values):
        world = plant(H, **values)
        state, c = world.state, world.config.object
        self.hand, self.shape, self.theta = world.hand, world.solid.shape, state.theta
        self.position, self.rotation = state.position, state.rotation
        self.mass, self.inertia = c.mass, c.inertia_about(c.solid())
        self.contacts, self.jacobian = state.contacts, jacobian(world, state)
        self.torque, self.past = np.zeros(9), no_past(3, np.zeros(15))

    def press(self, *forces):
        """Press along the normals, N."""
        pushes = np.array(forces)[:, None] * np.nan_to_num(self.contacts.normals)
        self.torque = self.jacobian.T @ pushes.ravel()

    def step(self, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), rates=np.zeros(9)):
        v = np.concatenate([rates, velocity, spin])
        theta, ahead = half_step(H, self.theta, v, v)
        terms = self.hand.raw_dynamics(theta, ahead[:9])
        hand = HandTerms(self.theta, *terms, self.torque, self.hand.radii)
        body = Body(self.position, self.rotation, ahead[12:], self.mass, self.inertia, np.zeros(6))
        return step(H, v, hand, body, self.shape, MU, self.past)

    def follow(self, after):
        """Go on from the end of a step with what it has left; return the next one."""
        self.theta, self.position, self.rotation = after.theta, after.position, after.rotation
        self.past, v = after.past, after.velocities
        return self.step(v[9:12], v[12:], v[:9])


def test_a_matrix_that_has_drifted_comes_back_to_the_nearest_rotation():
    """Newton's iteration: an error E of R = Q (I + E) becomes -3/2 E^2 - 1/2 E^3, and Q stays."""
    scene = Scene(**FAR)
    nearest = rotation_from_vector([0.7, -0.4, 1.1])
    error = 1e-3 * np.array([[1.0, 0.5, -0.7], [0.5, -2.0, 0.3], [-0.7, 0.3, 1.5]])
    scene.rotation = nearest @ (np.eye(3) + error)
    after = scene.step().rotation
    expected = nearest @ (np.eye(3) - 1.5 * error @ error - 0.5 * error @ error @ error)
    np.testing.assert_allclose(after, expected, atol=1e-14)
    for _ in range(2):
        scene.rotation = after
        after = scene.step().rotation
    np.testing.assert_allclose(after, nearest, atol=1e-14)


def test_a_steady_spin_turns_about_its_axis_in_the_palm_and_rotations_stay_rotations():
    scene, spin = Scene(**FAR), np.array([3.0, -5.0, 8.0])
    start = scene.rotation = rotation_from_vector([0.7, -0.4, 1.1])
    for _ in range(50):
        scene.rotation = scene.step(spin=spin).rotation
    expected = Rotation.from_rotvec(50 * H * spin).as_matrix() @ start
    np.testing.assert_allclose(scene.rotation, expected, atol=1e-13)
    np.testing.assert_allclose(scene.rotation.T @ scene.rotation, np.eye(3), atol=2e-15)


def test_each_finger_rubs_with_its_own_friction_and_slides_its_own_way():
    """A heavy object is drawn through the fingers: each slips along both axes of its face."""
    scene = Scene(object__mass=100.0, object__inertia=(9.0, 9.0, 9.0))
    scene.press(30.0, 50.0, 40.0)
    before = np.array([1e-3, 3e-3, 2e-3])
    scene.past = scene.past._replace(slid=before)
    velocity, spin = np.array([0.06, 0.07, -0.12]), np.array([0.2, 0.1, -0.3])
    after = scene.step(velocity, spin)
    impulses = after.past.impulses
    normal, rubbing = impulses[:, 1], impulses[:, [0, 2]]
    assert (normal > 1e-4).all()
    speeds = np.hypot(*after.sliding.T)
    assert np.abs(after.sliding).min() > 5e-3 and np.abs(np.diff(speeds)).min() > 5e-3
    np.testing.assert_allclose(
        rubbing, -(MU * normal / speeds)[:, None] * after.sliding, rtol=1e-6, atol=1e-12
    )
    # What slides is the point of the object against that of the tip, seen in the contact frame.
    points = scene.contacts.positions
    body = after.velocities[9:12] + np.cross(after.velocities[12:], points - scene.position)
    tips = (scene.jacobian @ after.velocities[:9]).reshape(3, 3)
    seen = np.einsum("kji,kj->ki", scene.contacts.rotations, body - tips)
    np.testing.assert_allclose(after.sliding, seen[:, [0, 2]], atol=2e-4)
    # From middle to middle of two steps the positions move by one step of these velocities.
    np.testing.assert_array_equal(after.past.slid, before)
    np.testing.assert_allclose(scene.follow(after).past.slid - before, H * speeds, rtol=5e-3)
    np.testing.assert_array_equal(before, [1e-3, 3e-3, 2e-3])


def test_a_vector_is_carried_to_where_the_tangents_of_a_contact_point_now():
    """Frames that flip about the normal within a step show the same force."""
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
        (6e-4, 1.0, -0.1),  # comes down: only what closes the gap of the middle of the step is left
        (-2e-5, -0.004, 0.004),  # was too deep, is on its way out already
        (-2e-5, 0.0, 0.004),  # was too deep: a fifth of it is taken back
        (-1e-3, 0.0, 0.005),  # the same, but no faster than that
        (6e-4, 0.2, -0.2),  # does not come down yet: nothing touches it
        (-1e-4, -1.0, 1.0),  # is on its way out quickly
    ],
)
def test_a_gap_is_closed_in_one_step_and_a_penetration_in_five(gap, speed, opening):
    """The gap is that of the middle of a step, whose path leads to the middle of the next."""
    scene = Scene(object__mass=0.5, object__inertia=(1e-3, 2e-3, 3e-3), **ONE)
    normal = scene.contacts.normals[2]
    scene.position = scene.position + gap * normal
    # It also slides: that is no business of the gap.
    after = scene.step(-speed * normal + [0.07, 0.0, 0.04])
    arm = scene.contacts.positions[2] - (scene.position - 0.5 * H * speed * normal)
    velocity, spin = after.velocities[9:12], after.velocities[12:]
    tip = scene.jacobian[6:] @ after.velocities[:9]
    assert normal @ (velocity + np.cross(spin, arm) - tip) == pytest.approx(opening, abs=2e-4)
    assert (after.past.impulses[2, 1] > 0.0) == (opening not in (-speed, 1.0))


def without_contacts(scene, v):
    """Return M in the middle of a step, shape (15, 15), and the velocities that no contact changes.

    v are those at the start and of the step before, shape (15,).
    """
    terms = scene.hand.raw_dynamics(scene.theta + 0.5 * H * v[:9], v[:9])
    turned = rotation_from_vector(0.5 * H * v[12:]) @ scene.rotation
    matrix = np.zeros((15, 15))
    matrix[:9, :9] = np.triu(terms.inertia) + np.triu(terms.inertia, 1).T
    matrix[9:12, 9:12] = scene.mass * np.eye(3)
    matrix[12:, 12:] = turned @ scene.inertia @ turned.T
    gyroscopic = np.cross(v[12:], matrix[12:, 12:] @ v[12:])
    forces = np.concatenate([-terms.bias, np.zeros(3), -gyroscopic])
    return matrix, v + H * np.linalg.solve(matrix, forces)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 5.0, 100.0])
@pytest.mark.parametrize("mass", [0.01, 0.3, 10.0])
def test_impacts_take_energy_and_do_not_rebound(friction, mass, monkeypatch):
    """Fingers and object fly about at random until they collide."""
    random, strikes = np.random.default_rng(int(1e3 * mass + friction)), 0
    monkeypatch.setitem(globals(), "MU", np.full(3, friction))
    for _ in range(20):
        speed = 10.0 ** random.uniform(-1.0, -0.3)
        inertia = 0.01 * mass * random.uniform(1.0, 1.8, 3)
        scene = Scene(object__mass=mass, object__inertia=tuple(inertia))
        scene.shape = ConvexPolyhedron.box(0.2604 - random.uniform(2e-3, 3e-3, 3)).shape
        v = 0.7 * speed * random.standard_normal(15)
        for _ in range(15):
            matrix, free = without_contacts(scene, v)
            after = scene.step(v[9:12], v[12:], v[:9])
            pushed = after.past.impulses[:, 1] > 0.0
            end = after.velocities
            assert end @ matrix @ end <= (free @ matrix @ free) * (1.0 + 1e-12)
            if pushed.any():
                # Seen from the fingertips, what they have struck is not on its way out.
                assert (after.past.rows @ end)[pushed, 1].max() < 1e-9
                strikes += 1
                break
            scene.theta, scene.position, scene.rotation = after[0], after.position, after.rotation
            v = end
    assert strikes > 5


def test_only_what_touches_or_is_pushed_is_seen():
    """A gap of a micrometre is none, and a push is felt whatever rounding makes of the gap."""
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
    shape = ConvexPolyhedron.box(size).shape
    rows = np.zeros((6, 3, 6))
    rows[:, 0, 2], rows[:, 1, 1], rows[:, 2, 0] = 1.0, 1.0, -1.0
    past = no_past(6, np.zeros(6))._replace(impulses=impulses, rows=rows)
    points, frames, found, felt = observed(shape, position, rotation, tips, radii, past)
    np.testing.assert_allclose(felt[:, 1], pushes)
    np.testing.assert_allclose(np.linalg.norm(felt, axis=1), np.linalg.norm(impulses, axis=1))
    np.testing.assert_allclose(found, gaps, atol=1e-12)
    seen = np.array([False, True, True, True, False, True])
    assert ((gaps > TOUCH) & (pushes == 0.0) == ~seen).all()
    np.testing.assert_array_equal(np.isfinite(points), np.outer(seen, [True] * 3))
    np.testing.assert_array_equal(np.isfinite(frames).all(axis=2), np.outer(seen, [True] * 3))
    np.testing.assert_array_equal(np.isnan(frames).any(axis=2), np.outer(~seen, [True] * 3))
    np.testing.assert_allclose(frames[seen][:, :, 1], -(faces @ rotation.T)[seen], atol=1e-12)
    expected = position + (on_face + gaps[:, None] * faces) @ rotation.T
    np.testing.assert_allclose(points[seen], expected[seen], atol=1e-12)


def test_a_step_that_nothing_touches_follows_its_own_mean_velocity():
    scene = Scene(**FAR)
    rates, velocity = np.linspace(-1.0, 1.0, 9), np.array([0.3, -0.2, 0.1])
    v = np.concatenate([rates, velocity, np.zeros(3)])
    theta, ahead = half_step(H, scene.theta, v, 0.5 * v)
    np.testing.assert_allclose(theta, scene.theta + 0.5 * H * rates, rtol=1e-15)
    np.testing.assert_allclose(ahead, 1.25 * v, rtol=1e-15)
    scene.torque = np.linspace(0.5, -0.5, 9)
    after = scene.step(velocity, rates=rates)
    end = after.velocities
    np.testing.assert_allclose(after.theta, scene.theta + 0.5 * H * (rates + end[:9]), rtol=1e-14)
    np.testing.assert_allclose(after.position, scene.position + H * velocity, rtol=1e-14)
    assert after.residual == 0.0 and after.outcome == 0
    np.testing.assert_array_equal(after.past.velocities, v)
    assert not after.past.settled.any() and not after.past.impulses.any()


def test_contacts_turn_and_slide_from_the_middle_of_a_step_to_that_of_the_next():
    """Pushed and settled, pushed only, not pushed, and one whose tangents have jumped round."""
    random, m = np.random.default_rng(2), 4
    frames = [rotation_from_vector(0.3 * random.standard_normal(3)) for _ in range(4)]
    turned = [rotation_from_vector(0.1 * random.standard_normal(3)) @ f for f in frames]
    turned[3] = frames[3] @ rotation_from_vector([0.0, 0.8, 0.0])
    before, now = (random.standard_normal((4, 3, m + 6)) for _ in range(2))
    before[:, :, m : m + 3] = np.swapaxes(frames, 1, 2)
    now[:, :, m : m + 3] = np.swapaxes(turned, 1, 2)
    v, slid = random.standard_normal(m + 6), np.array([1.0, 2.0, 3.0, 4.0])
    impulses = np.array([[0.1, 1.0, 0.1], [0.1, 1e-9, 0.1], [0.1, 0.0, 0.1], [0.1, 1.0, 0.1]])
    past = no_past(4, v)._replace(
        rows=before, impulses=impulses, settled=np.array([True, False, True, True]), slid=slid
    )
    turning, found = _since(H, v, now, past)
    new, old = now @ v, before @ v
    for i in (0, 1):
        old[i] = carried(now[i, :, m:], before[i, :, m:], old[i])
    old[3] = rotation_from_vector([0.0, -0.8, 0.0]) @ old[3]
    np.testing.assert_allclose(turning[::3], 0.5 * (new - old)[::3], rtol=1e-12)
    assert not turning[1:3].any()
    way = 0.5 * H * np.hypot(*(new + old)[:, [0, 2]].T)
    np.testing.assert_allclose(found - slid, [way[0], way[1], 0.0, way[3]], rtol=1e-9)
    np.testing.assert_array_equal(slid, [1.0, 2.0, 3.0, 4.0])
