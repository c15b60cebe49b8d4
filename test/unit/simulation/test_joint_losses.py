# SPDX-License-Identifier: Apache-2.0
"""Damping and Coulomb friction of the joints in the simulation, with both engines."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.hands import prism_grasp, write_hand
from support.plants import after, plant

FAR = {"object__position": (0.0, 0.0, 9.0)}
DOWN = (0.0, 0.0, -9.81)
COUPLED = {"f1_joint_4": {"joint": "f1_joint_3", "ratio": -0.5, "offset": 0.1}}
ENGINES = ["own", "mujoco"] if sys.version_info >= (3, 11) else ["own"]  # see conftest.py
CREEP = {"own": 1e-9, "mujoco": 1e-3}  # rad in half a second below the friction


@pytest.fixture(params=ENGINES)
def lossy(tmp_path, request):
    """Return a function that makes a plant whose joints have given damping and friction."""

    def made(damping, friction, joints=(3, 3, 3), losses="file", grasp=False, **values):
        if grasp:
            values |= prism_grasp(tmp_path, joints, joint_losses=losses)
        else:
            more = {"couplings": COUPLED} if 4 in joints else {}
            hand = write_hand(tmp_path, joints, joint_losses=losses, **more)
            values |= {"hand": str(hand), "initial_joints": [0.3] * 9, **FAR}
        urdf = (tmp_path / "hand.urdf").read_text().split("<axis")
        parts = [
            f'<dynamics damping="{damping * (1 + i)}" friction="{friction * (1 + i)}"/><axis{part}'
            for i, part in enumerate(urdf[1:])
        ]
        (tmp_path / "hand.urdf").write_text(urdf[0] + "".join(parts))
        values = {name.removeprefix("plant."): value for name, value in values.items()}
        world = plant(engine=request.param, **values)
        world.engine = request.param
        return world

    return made


def test_a_damped_joint_reaches_the_speed_at_which_damping_takes_the_torque(lossy):
    """Also with a time constant of a hundredth of a step."""
    for damping, ticks in ((2.0, 400), (1e4, 20)):
        world = lossy(damping, 0.0)
        assert_allclose(world.hand.damping, damping * np.arange(1, 10))
        torque = np.linspace(-0.08, 0.1, 9)
        state = after(world, ticks, torque)
        assert_allclose(state.rates, torque / world.hand.damping, rtol=0.02, atol=1e-9)


def test_friction_holds_the_weight_of_a_finger_and_no_more(lossy):
    """Above its friction a joint moves as without any, under the rest of the torque."""
    world = lossy(0.0, 0.001, gravity=DOWN)
    start = world.state.theta
    limit, weight = world.hand.friction, world.hand.gravity_torque(start)
    assert_allclose(limit, 0.001 * np.arange(1, 10))
    creep = CREEP[world.engine]
    signs = np.where(np.arange(9) % 2, -1.0, 1.0)
    assert abs(after(world, 500, weight + 0.98 * signs * limit).theta - start).max() < creep
    more = 0.5 * np.eye(9)[5]
    moved = after(world, 60, weight + signs * limit + more)
    turned = moved.theta - start
    assert turned[5] > 0.05 and abs(turned[[0, 1, 2, 6, 7, 8]]).max() < creep


def test_sliding_friction_takes_its_size_from_the_torque_and_ends_at_rest(lossy):
    world, free = lossy(0.0, 0.5), lossy(0.0, 0.0)
    i, limit = 8, 4.5
    torque = 6.0 * np.eye(9)[i]
    for each, part in ((world, torque), (free, torque - limit * np.eye(9)[i])):
        state = after(each, 50, part)
        assert state.rates[i] > 3.0
    assert (abs(world.state.theta - 0.3)[:6] < CREEP[world.engine]).all()  # the other fingers
    first = world.state.theta[i]
    at = after(world, 600)
    rest = after(world, 200)
    assert abs(rest.theta - at.theta).max() < 1e-9 and at.theta[i] > first
    world.reset()
    assert after(world, 50, torque).theta[i] == first


def test_a_joint_that_follows_resists_through_its_leader(lossy):
    """q_4 = -0.5 q_3: damping counts by the square of the ratio, friction by its size."""
    world = lossy(0.1, 0.2, joints=(4, 3, 3))
    assert world.hand.joint_names[2] == "f1_joint_3"
    assert_allclose(world.hand.damping[2], 0.1 * (3 + 0.25 * 4))
    assert_allclose(world.hand.friction[2], 0.2 * (3 + 0.5 * 4))
    creep, load = CREEP[world.engine], np.eye(9)[2]
    start = world.state.theta
    assert abs(after(world, 300, 0.98 * load).theta - start).max() < creep
    assert after(world, 300, 1.1 * load).theta[2] > start[2] + 1e-3


@pytest.mark.parametrize("lossy", ["own"], indirect=True)  # tips are stiff in MuJoCo
def test_joints_that_friction_holds_keep_an_object_without_torque(lossy):
    """Friction bears the load of the contacts; where it is too weak, they press less."""
    for friction in (6.0, 1.0):
        values = {"grasp": True, "object__mass": 0.2, "object__friction": 0.8}
        world = lossy(0.0, friction, **values, **{"contact.compliance": 1e-4})
        state = world.state
        tips = world.hand.fingertips(state.theta).linear
        press = np.einsum("kij,ki->j", tips, 8.0 * state.contacts.normals)
        held = after(world, 300, press + np.sign(press) * world.hand.friction).forces
        assert held[:, 1].min() > 5.0
        state = after(world, 300)
        tips = world.hand.fingertips(state.theta).linear
        load = np.einsum("kij,kim,km->j", tips, state.contacts.rotations, state.forces)
        assert (np.abs(load) < 1.01 * world.hand.friction).all() and state.contacts.all_touching
        kept = state.forces[:, 1].sum() / held[:, 1].sum()
        assert kept > 0.99 if friction > 1.0 else 0.1 < kept < 0.5


def test_losses_are_ignored_unless_the_yaml_asks_for_them(lossy):
    ignored, none = lossy(1.0, 2.0, losses="ignore"), lossy(0.0, 0.0)
    states = [after(world, 20, 0.3 * np.ones(9)) for world in (ignored, none)]
    np.testing.assert_array_equal(states[0].theta, states[1].theta)
    assert ignored.hand.damping.any() and not ignored.hand.has_losses
