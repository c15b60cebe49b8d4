# SPDX-License-Identifier: Apache-2.0
"""The simulation agrees with an adaptive integration of (2) to (6) that shares no code with it.

The controller is written here a second time too, from the paper's formulas with NumPy alone, and is
continuous as in the paper; so these tests cover plant, optimizer, law and the wiring of all blocks.
"""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from support.equations import grasp_map, rotation_error
from support.plants import plant, torque_for
from support.reference import Reference, State, World, rotation_of

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant_config import Disturbance

FACES = {
    "three_faces": np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]]),
    "pinch": np.array([[0, 1.0, 0], [0, 1.0, 0], [0, -1.0, 0]]),
}
TARGET = np.array([-0.1, 0.2, 0.4])


def reference_of(world, layout):
    """Return the reference for a plant, and its state at the start."""
    config, hand, state = world.config, world.hand, world.state
    tips = [f"finger_{i}_tip" for i in (1, 2, 3)]
    fingers = hand.description, tips, hand.radii
    body = config.object.mass, np.diag(config.object.inertia), np.array(config.gravity)
    reference = Reference(World(*fingers, *body, FACES[layout]))
    quaternion = Rotation.from_matrix(state.rotation).as_quat()
    start = State(state.theta, np.zeros(9), state.position, quaternion, np.zeros(3), np.zeros(3))
    return reference, start


def drift(reference, y):
    """Return the largest violation of (6), m/s."""
    s = reference.unpack(y)
    hand, solid, _ = reference.contact_rows(s)
    return np.abs(hand @ s.rates - solid @ np.concatenate([s.velocity, s.spin])).max()


class PaperLaw:
    """The law (14) as the paper prints it, for a target with R_pod = I."""

    def __init__(self, reference):
        self.reference = reference

    def __call__(self, t, s, points):
        centroid = points.mean(axis=0)
        grasp = grasp_map(points, centroid)
        forces = 10.0 * self.optimal(s, grasp)
        turn = rotation_error(points, np.eye(3))
        wrench = np.concatenate([3.0 * (TARGET - centroid), 0.5 * turn])
        jacobian, *_ = self.reference.contact_rows(s)
        return jacobian.T @ (forces + np.linalg.pinv(grasp) @ wrench) - 0.07 * s.rates

    def optimal(self, s, grasp):
        """Solve (13) in closed form; the inequality does not bind in these grasps."""
        rotation = rotation_of(s)
        frames = np.zeros((9, 9))
        for i, face in enumerate(self.reference.world.faces):
            n = -rotation @ face
            t_z = np.array([0.0, 0.0, 1.0]) - n * n[2]
            t_z /= np.linalg.norm(t_z)
            frames[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.stack([pin.skew(n) @ t_z, n, t_z]).T
        rows = np.vstack([grasp @ frames, np.tile([0.0, 1.0, 0.0], 3)])
        spread = rows / np.tile([10.0, 1.0, 10.0], 3)
        forces = spread.T @ np.linalg.solve(spread @ rows.T, np.eye(7)[6])
        assert forces[1::3].min() > 0.0
        return frames @ forces


@pytest.mark.parametrize(("layout", "seconds"), [("three_faces", 10.0), ("pinch", 3.0)])
def test_the_closed_loop_moves_as_the_reference(layout, seconds):
    """The paper's 10 s, and of a pinch as far as it moves."""
    loop = ClosedLoop(load_scenario("paper", {"layout": layout, "duration": seconds}))
    reference, start = reference_of(loop.plant, layout)
    times = np.arange(0.0, seconds, 0.2)
    states, forces = reference.run(start, PaperLaw(reference), times, rtol=1e-8)
    worst = max(drift(reference, y) for y in states)
    record, rows = loop.run(), np.round(500.0 * times).astype(int)
    positions = [reference.unpack(y).position for y in states]
    position = np.abs(record.object_position[rows] - positions).max()
    centroids = [reference.contacts(y).mean(axis=0) for y in states]
    centroid = np.abs(record.true_positions[rows].mean(axis=1) - centroids).max()
    frames = Rotation.from_quat(record.true_quaternions[rows].reshape(-1, 4)).as_matrix()
    seen = np.einsum("nij,nj->ni", frames, record.true_forces[rows].reshape(-1, 3))
    # The simulation gives the mean force of the step that ended: there is none at the start.
    force = np.abs(seen.reshape(-1, 3, 3) - forces)[1:].max()
    print(f"drift of the reference {worst:.1e} m/s")
    print(f"object {1e3 * position:.4f} mm, centroid {1e3 * centroid:.4f} mm, force {force:.1e} N")
    assert worst < 1e-9
    assert position < 2e-6 and centroid < 2e-6
    assert force < 1e-3 * 10.0


@pytest.mark.parametrize("layout", ["three_faces", "pinch"])
def test_gravity_push_and_unequal_inertia_move_as_the_reference(layout):
    """An open-loop swing with everything at once, in small steps."""
    step, wrench = 1e-4, np.array([0.3, -0.2, 0.4, 0.01, 0.02, -0.01])
    push = Disturbance(force=tuple(wrench[:3]), torque=tuple(wrench[3:]))
    body = {"object__mass": 0.2, "object__inertia": (0.001, 0.002, 0.003)}
    world = plant(step, layout=layout, gravity=(0.5, 0.0, -2.0), disturbances=[push], **body)
    reference, start = reference_of(world, layout)
    torque = torque_for(world, 4.0 * world.state.contacts.normals * [[1.0], [1.0], [1.5]])
    times = np.linspace(0.0, 0.15, 4)
    states, _ = reference.run(start, lambda *_: torque, times, wrench=wrench)
    moved, turned = [], []
    for tick in range(1501):
        if tick % 500 == 0:
            moved.append(world.state.position)
            turned.append(world.state.rotation)
        world.advance(torque)
    assert world.state.contacts.touching.all() and not (np.abs(world.state.sliding) > 1e-9).any()
    ends = [reference.unpack(y) for y in states]
    assert np.linalg.norm(ends[-1].position - start.position) > 0.005
    np.testing.assert_allclose(moved, [s.position for s in ends], atol=2e-5)
    rotations = [Rotation.from_quat(s.quaternion).as_matrix() for s in ends]
    np.testing.assert_allclose(turned, rotations, atol=2e-4)
