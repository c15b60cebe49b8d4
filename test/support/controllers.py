# SPDX-License-Identifier: Apache-2.0
"""A controller to test with, and its input for the paper's grasp at rest."""

from functools import cache
from typing import Any

import numpy as np

from support.grasps import FORCES, Array, moved
from support.plants import plant
from tactile_hand_ros.control.contact import Contacts, in_palm, joint_torques
from tactile_hand_ros.control.controller import Command, Controller, ControllerConfig
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import rotation_from_vector
from tactile_hand_ros.simulation.plant import PlantState

TICK = 2_000_000
REST = np.zeros(9)

FEELING = {"law__observer__time": 0.02, "touch_latency": 0.0}
"""Parameters with which a controller compares forces and torques, as keywords of `Bench`."""

JOINTS = set(Joints._fields)

TABLE_I = {"law.k_p": 3.0, "law.k_o": 0.5, "law.damping": 0.07, "reference_time": 0.0}


@cache
def _grasp() -> tuple[PlantState, Array]:
    """Return the state of the paper's grasp at rest, and its f*; `Bench` writes into neither."""
    state = plant().state
    return state, ForceOptimizer(ForceOptimizerConfig(), 3).solve(state.contacts).forces


class Bench:
    """A controller with the paper's grasp at rest; contacts may move without the joints.

    Parameters are given by their dotted names, with two underscores for each dot.
    """

    def __init__(self, **values: Any) -> None:
        state, self.optimal = _grasp()
        changes = {name.replace("__", "."): value for name, value in values.items()}
        self.controller = Controller(
            ControllerConfig().changed({"touch_tolerance": 10.0, **TABLE_I, **changes})
        )
        self.theta, self.contacts, self.rates = state.theta, state.contacts, REST
        self.grasp_force, self.stamp = 10.0, 0

    def step(self, ticks: int = 1, **given: Any) -> Command:
        """Answer the next ticks, with other joints or touch if given; return the last command."""
        joints = self._joints(**{name: given.pop(name) for name in JOINTS & given.keys()})
        touch = {"contacts": self.contacts, "optimal_forces": self.optimal}
        seen = {**touch, "grasp_force": self.grasp_force, **given}
        for _ in range(ticks):
            command = self.controller.step(self.stamp, joints, **seen)
            self.stamp += TICK
        return command

    def hold(self, *, grasp_force: float = 0.0, **joints: Any) -> Command:
        """Answer a tick without touch, by default with joints at rest."""
        seen = self._joints(**{"rates": REST, **joints})
        return self.controller.hold(seen, "silence", grasp_force)

    def _joints(self, **given: Any) -> Joints:
        return Joints(**{"theta": self.theta, "rates": self.rates, **given})

    def without_finger(self, finger: int) -> Contacts:
        """Return the contacts without that of one finger."""
        positions = self.contacts.positions.copy()
        rotations = self.contacts.rotations.copy()
        positions[finger] = rotations[finger] = np.nan
        return Contacts(positions, rotations)

    @property
    def nowhere(self) -> Contacts:
        """No contact at any finger."""
        return Contacts(np.full((3, 3), np.nan), self.contacts.rotations)

    def elsewhere(self, *shift: float, turn: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Contacts:
        """Return the contacts after a motion of the grasp about its centroid."""
        rotation = rotation_from_vector(turn)
        return moved(self.contacts, rotation, self.centroid - rotation @ self.centroid + shift)

    def pressing(self, forces: Array = FORCES) -> Array:
        """Return the joint torques at rest for forces in contact frames, shape (9,), N m."""
        hand, press = self.controller.hand, in_palm(self.contacts.rotations, forces, 1.0)
        torque = joint_torques(hand.fingertips(self.theta), self.contacts.positions, press)
        return torque + hand.gravity_torque(self.theta)

    def stiffness(self, theta: Array) -> Array:
        """Return the stiffness of the safe hold at ticks of 2 ms, shape (9, 9), N m/rad."""
        return (0.5 / 0.007) ** 2 * self.controller.hand.dynamics(theta, REST)[1]

    @property
    def centroid(self) -> Array:
        """Mean of the contact points, shape (3,), m."""
        return self.contacts.centroid

    @property
    def shift(self) -> Array:
        """How far the present target is from the centroid, shape (3,), m."""
        return self.controller.targets.target.position - self.centroid

    def target(self, *shift: float, turn: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Target:
        """Return a pose away from the centroid, and rotated from the palm axes."""
        return Target(self.centroid + np.array(shift), rotation_from_vector(turn))
