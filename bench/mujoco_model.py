# SPDX-License-Identifier: Apache-2.0
"""The same hand and box for MuJoCo, as a yardstick of speed: its contacts are soft, ours rigid."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.plant import Plant

Array = NDArray[np.float64]


class MujocoPlant:
    """Steps the hand of a scenario and its box in MuJoCo."""

    def __init__(self, scenario: Scenario) -> None:
        """Build the model and put it where the plant starts."""
        config = scenario.plant
        hand = Hand.load(config.hand, config.layout)
        spec = mujoco.MjSpec.from_string(_with_tips(hand, config.hand))
        spec.option.timestep = config.time_step
        spec.option.gravity = list(config.gravity)
        spec.compiler.balanceinertia = True  # the paper's inertia is not that of a rigid body
        spec.compiler.boundmass, spec.compiler.boundinertia = 1e-6, 1e-9  # the knuckles have none
        box = spec.worldbody.add_body(name="object", pos=list(config.object.position))
        box.add_freejoint()
        half = [0.5 * edge for edge in config.object.size]
        box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, friction=[1.0, 0.0, 0.0])
        box.mass, box.explicitinertial = config.object.mass, True
        box.inertia = list(config.object.inertia)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        order = [self._model.joint(name) for name in hand.joint_names]
        self._dofs = [int(joint.dofadr[0]) for joint in order]
        start = Plant(config).state.theta
        for joint, angle in zip(order, start, strict=True):
            self._data.qpos[joint.qposadr[0]] = angle

    def advance(self, torque: Array, steps: int) -> None:
        """Hold torques for some steps."""
        self._data.qfrc_applied[self._dofs] = torque
        mujoco.mj_step(self._model, self._data, nstep=steps)

    @property
    def contacts(self) -> int:
        """Number of contacts at the last step."""
        return int(self._data.ncon)


def _with_tips(hand: Hand, name: str) -> str:
    """Return the URDF with a sphere to collide with at each fingertip, as MuJoCo reads it."""
    text = hand.description
    for finger in load_hand_config(name).fingers:
        shape = f'<geometry><sphere radius="{finger.radius}"/></geometry>'
        link = f'<link name="{finger.tip}">'
        text = text.replace(link, f"{link}<collision>{shape}</collision>")
    return text
