# SPDX-License-Identifier: Apache-2.0
"""The plant with MuJoCo: against the own engine, statics, Coulomb's law, and its error text."""

import sys

import numpy as np
import pytest
from support.hands import prism_grasp, write_hand
from support.plants import after, forces_in_palm, holding, plant, squeeze, torque_for

from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.extras import MissingLibraryError
from tactile_hand_ros.simulation.plant_config import Disturbance, FrictionChange

FAR = {"object__position": (0.0, 0.0, 9.0), "object__mass": 0.2}
TILTED = {"gravity": (1.0, -2.0, -5.0), "object__inertia": (0.001, 0.002, 0.0028), **FAR}
TURNS = [{"time": 0.4, "rotation": (0.5, 1.0, -0.3)}]
COUPLED = {
    "f1_joint_4": {"joint": "f1_joint_3", "ratio": 0.7, "offset": 0.1},
    "f2_joint_3": {"joint": "f2_joint_1", "ratio": -0.5},
}


def both(**values):
    return plant(**values), plant(engine="mujoco", **values)


def held(friction, **values):
    """Return a function that advances a block that stiff joints hold with 10 N by a tick."""
    body = {"layout": "pinch", "object__mass": 0.2, "object__friction": friction}
    world = plant(engine="mujoco", **body, **values)
    return holding(world, squeeze(world.state, 10.0)).__next__


@pytest.mark.parametrize("more", [{}, {"palm_motion": TURNS}, {"calibration.link_lengths": 1.2}])
def test_free_bodies_move_as_with_the_own_engine(more):
    """Joints swing, and the object falls and tumbles; the difference is of first order."""
    push = Disturbance(kind="pulse", force=(0.2, 0.0, 0.1), torque=(0.01, 0.12, 0.02))
    worlds = both(step=0.0005, disturbances=[push], **TILTED, **more)
    torque = np.array([0.3, -0.2, 0.1, 0.0, 0.2, -0.1, 0.1, 0.05, 0.0])
    ours, other = (after(world, 300, torque) for world in worlds)
    assert np.abs(ours.rates).max() > 0.5 and np.abs(ours.spin).max() > 1.0
    for name in ("theta", "rates", "position", "rotation", "velocity", "spin"):
        np.testing.assert_allclose(getattr(other, name), getattr(ours, name), 2e-3, 2e-3)


def test_joints_that_follow_move_as_with_the_own_engine(tmp_path):
    """They pull on the joint that they follow."""
    hand = str(write_hand(tmp_path, [4, 3, 3], couplings=COUPLED))
    start = {"hand": hand, "initial_joints": [0.3, 0.1, 0.4, 0.2, 0.3, 0.5, 0.2, 0.7]}
    worlds = both(**start, **TILTED)
    ours, other = (after(world, 200) for world in worlds)
    assert np.abs(ours.rates).max() > 0.5
    np.testing.assert_allclose(other.theta, ours.theta, 2e-3, 2e-3)


def test_forces_are_those_of_statics():
    """From the first step on; in sum they balance weight and pull."""
    pull = [Disturbance(kind="step", force=(0.5, 0.2, -1.0))]
    advance = held(0.8, disturbances=pull, gravity=(0.0, 0.0, -2.0))
    assert advance().forces[:, 1].min() > 2.0
    for _ in range(1500):
        state = advance()
    forces = forces_in_palm(state)
    np.testing.assert_allclose(forces.sum(axis=0), [-0.5, -0.2, 1.0 + 0.4], atol=5e-3)
    moments = np.cross(state.contacts.positions - state.position, forces).sum(axis=0)
    np.testing.assert_allclose(moments, 0.0, atol=1e-3)
    assert state.slid.max() < 5e-5 and np.abs(state.gaps).max() < 2e-6


@pytest.mark.parametrize("friction", [0.2, 1.0])
def test_a_block_slides_when_coulomb_says_so(friction):
    """No contact ever carries more than mu f_n, and those that slide carry that."""
    most = 12.0 * friction
    pull = Disturbance(kind="ramp", duration=1.5, force=(0.0, 0.0, most))
    advance, states = held(friction, disturbances=[pull]), []
    while len(states) < 1500 and (not states or states[-1].speeds.min() < 1e-3):
        states.append(advance())
    started = most * len(states) / 1500
    normals = np.array([state.forces[:, 1] for state in states])
    across = np.array([np.hypot(state.forces[:, 0], state.forces[:, 2]) for state in states])
    assert (across <= 1.001 * friction * normals + 1e-9).all()
    assert started == pytest.approx(friction * normals[-100:].sum(axis=1).mean(), rel=0.04)
    for _ in range(50):
        state = advance()
    across = np.hypot(state.forces[:, 0], state.forces[:, 2])
    assert across == pytest.approx(friction * state.forces[:, 1], rel=0.02)


def test_a_change_of_friction_acts_from_its_time_on():
    pull = Disturbance(kind="step", force=(0.0, 0.0, 2.0))
    changes = [FrictionChange(start=0.3, friction=0.1)]
    advance = held(0.8, disturbances=[pull], friction_changes=changes)
    states = [advance() for _ in range(400)]
    assert states[299].slid.max() < 1e-5 < 1e-3 < states[-1].slid.max()


def test_a_polyhedron_is_touched_where_it_is_with_the_own_engine(tmp_path):
    """MuJoCo moves a mesh into its own principal axes."""
    changes = {k: v for k, v in prism_grasp(tmp_path, [4, 3, 3]).items() if k != "layout"}
    values = {k.removeprefix("plant."): v for k, v in changes.items()}
    worlds = both(**values, object__mass=0.3, object__rotation=(0.0, 0.0, 0.02))
    torques = [torque_for(world, 5.0 * world.state.contacts.normals) for world in worlds]
    ours, other = (after(w, 30, t) for w, t in zip(worlds, torques, strict=True))
    assert ours.forces[:, 1].min() > 1.0 and np.abs(ours.spin).max() > 1e-3
    np.testing.assert_allclose(other.forces, ours.forces, atol=0.05)
    np.testing.assert_allclose(other.rotation, ours.rotation, atol=1e-5)


def test_a_reset_starts_the_same_run_with_the_same_bits():
    world = plant(engine="mujoco", layout="pinch", gravity=(0.0, 0.0, -1.0), object__mass=0.2)
    torque = torque_for(world, squeeze(world.state, 10.0))
    runs = []
    for _ in range(2):
        world.reset()
        runs.append(after(world, 50, torque))
    for name in ("theta", "position", "forces"):
        np.testing.assert_array_equal(*(getattr(run, name) for run in runs))


def test_a_joint_stops_at_its_limit_and_a_simulation_that_diverges_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hand = str(write_hand(tmp_path, [3, 3, 3], limits={"f1_joint_1": {"upper": 0.5}}))
    world = plant(engine="mujoco", hand=hand, initial_joints=[0.3, 0.0, 0.5], **FAR)
    pushed = np.eye(9)[0]
    state = after(world, 500, pushed)
    assert state.theta[0] == pytest.approx(0.5, abs=1e-4) and abs(state.rates[0]) < 1e-4
    with pytest.raises(DivergedError, match="has diverged"):
        world.advance(np.full(9, np.nan))
    assert np.isfinite(world.reset().theta).all() and world.advance(pushed).theta[0] > 0.3
    assert not list(tmp_path.glob("MUJOCO*"))


def test_a_missing_library_is_named_with_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingLibraryError, match=r"plant\.engine: mujoco .*install mujoco-core`"):
        plant(engine="mujoco")


@pytest.mark.parametrize(
    ("shape", "size"),
    [("cylinder", (0.26, 0.26, 0.4)), ("sphere", (0.26,) * 3), ("capsule", (0.26, 0.26, 0.5))],
)
def test_round_objects_are_pressed_as_with_the_own_engine(shape, size):
    worlds = both(object__shape=shape, object__size=size, object__mass=0.2, object__inertia=())
    torque = torque_for(worlds[0], squeeze(worlds[0].state, 10.0))
    ours, other = (after(world, 50, torque) for world in worlds)
    np.testing.assert_allclose(other.forces, ours.forces, rtol=0.02, atol=0.1)
    np.testing.assert_allclose(other.position, ours.position, atol=1e-4)
    assert other.forces[:, 1].min() > 1.0
