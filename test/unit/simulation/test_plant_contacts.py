# SPDX-License-Identifier: Apache-2.0
"""The plant in contact: balance of momentum, stick, slip, lift-off, rolling; soft fingertips."""

from itertools import islice

import numpy as np
import pytest
from support.hands import tip_rotations
from support.plants import (
    after,
    energy_of,
    forces_in_palm,
    holding,
    jacobian,
    plant,
    squeeze,
    torque_for,
)

from tactile_hand_ros.simulation.contact_step import velocity_map
from tactile_hand_ros.simulation.plant_config import Disturbance

HEAVY = {"object__mass": 0.2, "layout": "pinch"}
PUSHES = np.array([[-3.0, 0.4, 0.3], [3.0, 0.4, 0.3], [0.0, -0.6, 0.3]])


def shaken(seed, ticks=200, **values):
    """Yield a plant and its states under torques that squeeze, drag, open and close the grasp."""
    random = np.random.default_rng(seed)
    body = {"object__mass": 0.1, "object__inertia": [0.0014] * 3}
    world = plant(gravity=(0.0, 0.0, -3.0), **body, **values)
    transposed, normals = jacobian(world, world.state).T, world.state.contacts.normals
    for tick in range(ticks):
        if tick % 20 == 0:
            pushes = normals * random.uniform(-0.5, 3.0, (3, 1)) + random.standard_normal((3, 3))
        yield world, world.advance(transposed @ pushes.ravel() - 0.07 * world.state.rates)


@pytest.mark.parametrize("friction", [0.2, 0.8, 2.0])
@pytest.mark.parametrize("layout", ["three_faces", "pinch"])
def test_every_state_obeys_the_contact_laws(friction, layout):
    """For any torques: pushing only, inside the cone, on it and against the motion when sliding."""
    seen = set()
    for seed in range(3):
        for world, state in shaken(seed, object__friction=friction, layout=layout):
            assert world.contact_residual < 1e-8
            push, normal = np.hypot(state.forces[:, 0], state.forces[:, 2]), state.forces[:, 1]
            size = max(1e-3, normal.max())
            assert normal.min() >= 0.0
            assert (push <= friction * normal + 1e-7 * size).all()
            assert world.relaxed_steps == world.unsolved_steps == 0
            assert state.gaps.min() > -5e-5
            for i in range(3):
                speed = np.linalg.norm(state.sliding[i])
                if normal[i] == 0.0:
                    seen.add("open")
                    continue
                assert abs(state.gaps[i]) < 5e-4 and state.contacts.touching[i]
                if speed < 1e-7:
                    seen.add("stick")
                    continue
                seen.add("slip")
                expected = -friction * normal[i] * state.sliding[i] / speed
                np.testing.assert_allclose(state.forces[i, [0, 2]], expected, atol=2e-3 * size)
    assert seen == {"open", "stick", "slip"}


@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere"])
def test_a_stuck_grasp_neither_gains_nor_loses_energy(shape):
    """Sticking and rolling contacts do no work: the energy is the joints' work, better with h."""
    errors = []
    for step in (0.002, 0.001, 0.0005):
        world = plant(step, object__mass=0.2, gravity=(0.0, 0.0, -1.0), object__shape=shape)
        torque, start, before = torque_for(world, PUSHES), world.state.theta, energy_of(world)
        state = after(world, round(0.25 / step), torque)
        assert state.contacts.touching.all() and not (np.abs(state.sliding) > 1e-9).any()
        assert np.linalg.norm(state.position - [0.0, 0.0, 0.4098]) > 0.005
        work = torque @ (state.theta - start)
        errors.append(abs(energy_of(world) - before - work) / abs(work))
    assert errors[1] < 1e-4
    assert errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1]


def test_nothing_creeps_under_a_load_inside_the_cone():
    """Three seconds at nine tenths of the friction limit: not a nanometer."""
    world = plant(object__friction=0.5, disturbances=[Disturbance(force=(0.0, 0.0, -4.5))], **HEAVY)
    forces = squeeze(world.state, 10.0) + np.outer([0.25, 0.25, 0.5], [0.0, 0.0, 4.5])
    states = list(islice(holding(world, forces), 3000))
    moved = [np.abs(s.position - [0.0, 0.0, 0.4098]).max() for s in states]
    assert max(moved) < 1e-9
    last = states[-1]
    used = np.hypot(last.forces[:, 0], last.forces[:, 2]) / last.forces[:, 1]
    np.testing.assert_allclose(used, 0.45 / 0.5 * 0.5, atol=1e-6)
    np.testing.assert_allclose(forces_in_palm(last).sum(axis=0), [0.0, 0.0, 4.5], atol=1e-8)


def test_a_load_beyond_the_cone_slides_at_the_limit():
    """Six newtons against a friction of five: the rest accelerates the object; the tips rest."""
    world = plant(object__friction=0.5, disturbances=[Disturbance(force=(0.0, 0.0, -6.0))], **HEAVY)
    forces = squeeze(world.state, 10.0) + np.outer([0.25, 0.25, 0.5], [0.0, 0.0, 5.0])
    states = list(islice(holding(world, forces), 100))
    for state in states[5:]:
        assert (state.sliding[:, 1] < 0.0).all()  # z of the frames is palm z: it slides down
        np.testing.assert_allclose(state.forces[:, 2], 0.5 * state.forces[:, 1], rtol=1e-6)
    last = states[-1]
    # The tips rest, so each contact slides as far as the object moves down.
    np.testing.assert_allclose(last.slid, 0.4098 - last.position[2], rtol=0.03)
    assert last.slid.min() > 1e-3
    np.testing.assert_allclose(last.velocity[2], -(6.0 - 5.0) / 0.2 * 0.1, rtol=0.02)
    assert np.abs(last.rates).max() < 0.05 * abs(last.velocity[2])


@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere"])
def test_contacts_roll_equally_far_over_tip_and_object(shape):
    """(6): without slip the contact point travels the same arc over the sphere and the object."""
    world = plant(0.0005, object__mass=0.2, object__shape=shape)
    pushes = np.array([[-3.0, 0.5, 0.4], [3.0, 0.5, 0.4], [0.0, -0.6, 0.2]])
    torque, names = torque_for(world, pushes), [f"finger_{i}_tip" for i in (1, 2, 3)]

    def on_both(state):
        points = state.contacts.positions
        tips = world.hand.fingertips(state.theta).positions
        turned = tip_rotations(world.hand.description, names, state.theta)
        on_tip = np.einsum("kji,kj->ki", turned, points - tips)
        return (points - state.position) @ state.rotation, on_tip

    arcs = np.zeros((2, 3))
    before = on_both(world.state)
    for _ in range(500):
        now = on_both(world.advance(torque))
        arcs += [np.linalg.norm(b - a, axis=1) for a, b in zip(before, now, strict=True)]
        before = now
    assert arcs.max() > 0.005
    # Their difference is `slid`, of second order in the step.
    np.testing.assert_allclose(arcs[0], arcs[1], rtol=1e-4)
    assert world.state.slid.max() < 2e-6


OPPOSED = {"object__size": (0.2604, 0.24, 0.2604), "object__mass": 0.2}  # fingers 1 and 2 touch


def held(world, forces, ticks):
    """Return the state after a posture was held for some ticks; see `holding`."""
    return next(islice(holding(world, forces), ticks - 1, None))


def test_at_rest_a_soft_tip_is_indented_by_compliance_times_force():
    world = plant(layout="pinch", object__mass=0.2, contact__compliance=1e-4)
    state = held(world, squeeze(world.state, 10.0), 2000)
    assert state.forces[:, 1].min() > 1.0 and state.forces[2, 1] > 1.5 * state.forces[0, 1]
    np.testing.assert_allclose(state.gaps, -1e-4 * state.forces[:, 1], atol=1e-9)


def carried_by(compliance):
    """Return a plant whose object was pushed through the palm for 0.25 s, without slip."""
    world = plant(object__mass=0.2, gravity=(0.0, 0.0, -1.0), contact__compliance=compliance)
    after(world, 250, torque_for(world, PUSHES))
    return world


def test_the_stiffer_a_soft_tip_the_more_it_is_like_a_rigid_one():
    """To first order in the compliance; and contacts stick."""
    rigid, errors = carried_by(0.0).state, []
    for compliance in (1e-5, 1e-6, 1e-12):
        state = carried_by(compliance).state
        errors.append(np.abs(state.position - rigid.position).max())
        assert state.slid.max() < 1e-6
    assert errors[0] > 1e-5 and errors[1] == pytest.approx(0.1 * errors[0], rel=0.02)
    assert errors[2] < 1e-10


def twisted(moment, load, torsion):
    """Return plant, state and angular momentum about both normals after 0.2 s of moment and load.

    Two opposed contacts press with 8 N each at mu = 0.5; the load pulls the object down.
    """
    push = Disturbance(force=(0.0, 0.0, -load), torque=(moment, 0.0, 0.0))
    values = {"object__friction": 0.5, "contact__torsion": torsion, "disturbances": [push]}
    world = plant(**OPPOSED, **values)
    forces = np.zeros((3, 3))
    forces[:2] = 8.0 * world.state.contacts.normals[:2] + [0.0, 0.0, 0.5 * load]
    state = held(world, forces, 200)
    return world, state, world.body_inertia[3, 3] * state.spin[0]


@pytest.mark.parametrize("used", [0.0, 0.3, 0.6, 0.9])
def test_a_twist_is_held_up_to_the_ellipse_and_no_further(used):
    """(f_t / mu f_n)^2 + (tau / torsion mu f_n)^2 = 1, with a part of the friction used by load."""
    load, limit = used * 2 * 0.5 * 8.0, 2 * 0.01 * 0.5 * 8.0 * np.sqrt(1.0 - used**2)
    _, state, momentum = twisted(0.97 * limit, load, 0.01)
    assert abs(momentum) < 1e-6 and not (np.abs(state.sliding) > 1e-9).any()
    world, state, momentum = twisted(1.03 * limit, load, 0.01)
    assert momentum == pytest.approx(0.2 * 0.03 * limit, rel=0.05)
    # While it turns a little, the load moves it, too.
    assert (state.sliding[:2, 1] < -5e-4).all() == (used > 0.0)
    assert world.contact_residual < 1e-10 and world.unsolved_steps == 0


def test_a_point_contact_bears_no_moment():
    assert twisted(0.01, 0.0, 0.0)[2] == pytest.approx(0.2 * 0.01, rel=1e-6)


def test_a_soft_tip_shears_and_does_not_slide_until_coulombs_limit():
    """By 1.5 compliance times tangential force, two contacts side by side."""

    def pulled(load):
        push = Disturbance(force=(0.0, 0.0, -load))
        values = {"object__friction": 0.5, "contact__compliance": 1e-4, "disturbances": [push]}
        world = plant(**OPPOSED, **values)
        start, hand = world.state, world.hand
        tips, turns = hand.tip_positions(start.theta), hand.tip_rotations(start.theta)
        forces = np.zeros((3, 3))
        forces[:2] = 8.0 * start.contacts.normals[:2]
        state = held(world, forces, 1000)
        turned = hand.tip_rotations(state.theta) @ np.swapaxes(turns, 1, 2)
        arms = (start.contacts.positions - tips)[:, :, None]
        carried = hand.tip_positions(state.theta) + (turned @ arms - arms)[:, :, 0] - tips
        return (state.position - start.position)[2] - carried[:2, 2].mean(), state

    sheared, state = pulled(6.0)
    assert sheared == pytest.approx(-1.5e-4 * 6.0 / 2.0, rel=0.02)
    assert state.slid.max() < 1e-9
    assert pulled(9.0)[1].slid[:2].min() > 1e-4


def test_a_moment_acts_against_the_spin_of_the_object_relative_to_the_tip():
    world, velocity = plant(), np.random.default_rng(1).standard_normal(15)
    state, rates = world.state, velocity[:9]
    tips, contacts = world.hand.fingertips(state.theta), state.contacts
    rows = velocity_map(tips, state.position, contacts.positions, contacts.rotations, 0.02)
    spins = velocity[12:] - tips.angular @ rates
    expected = 0.02 * (spins * contacts.normals).sum(axis=1)
    np.testing.assert_allclose(rows[:, 3] @ velocity, expected, atol=1e-12)
