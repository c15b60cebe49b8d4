# SPDX-License-Identifier: Apache-2.0
"""Soft fingertips: indentation under a force, and a moment about the normal up to a limit."""

from itertools import islice

import numpy as np
import pytest
from support.plants import holding, plant, squeeze, torque_for

from tactile_hand_ros.simulation.contact_step import velocity_map
from tactile_hand_ros.simulation.plant_config import Disturbance

OPPOSED = {"object__size": (0.2604, 0.24, 0.2604), "object__mass": 0.2}  # fingers 1 and 2 touch
PUSHES = np.array([[-3.0, 0.4, 0.3], [3.0, 0.4, 0.3], [0.0, -0.6, 0.3]])


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
    torque = torque_for(world, PUSHES)
    for _ in range(250):
        world.advance(torque)
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
    terms = world.hand.raw_dynamics(state.theta, rates)
    contacts = state.contacts
    rows = velocity_map(terms, state.position, contacts.positions, contacts.rotations, 0.02)
    spins = velocity[12:] - world.hand.fingertips(state.theta).angular @ rates
    expected = 0.02 * (spins * contacts.normals).sum(axis=1)
    np.testing.assert_allclose(rows[:, 3] @ velocity, expected, atol=1e-12)
