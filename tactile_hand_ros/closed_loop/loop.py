# SPDX-License-Identifier: Apache-2.0
"""The five blocks wired together: the paper without ROS, and the reference for the ROS graph.

The blocks are plant, skin, slip regulator, force optimizer and controller. A `Chain` wires the last
three, and a `SensingChain` adds the skin before them. `ClosedLoop` closes the loop with the plant
and records it. A process with several nodes runs the same chains, with a node around each block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Command, Controller
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, OptimalForces
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.mujoco_plant import make_plant
from tactile_hand_ros.simulation.plant import PlantState
from tactile_hand_ros.simulation.skin import TactileReading, TactileSensor


class Answer(NamedTuple):
    """The blocks' answer to a tick: k_f [N], f* and the torques."""

    grasp_force: float
    optimal: OptimalForces
    command: Command


@dataclass
class Chain:
    """From joints and touch to torques; the blocks may be nodes that wrap them."""

    regulator: SlipRegulator
    optimizer: ForceOptimizer
    controller: Controller

    def answer(self, stamp: int, joints: Joints, contacts: Contacts, forces: Array) -> Answer:
        """Return the answer to a tick [ns]; see `Controller.step` for joints and touch."""
        grasp_force = self.regulator.step(stamp, joints, contacts, forces)
        optimal = self.optimizer.step(stamp, contacts, self.regulator.carried, grasp_force)
        touch = contacts, optimal.forces, grasp_force, forces
        command = self.controller.step(stamp, joints, *touch)
        self.pass_back()
        return Answer(grasp_force, optimal, command)

    def write(self, record: Record, row: int, answer: Answer) -> None:
        """Write the answer to a tick into a row; what is unknown stays NaN."""
        command = answer.command
        record.grasp_force[row] = answer.grasp_force
        record.optimal_forces[row] = answer.optimal.forces
        record.command[row] = command.torque
        if command.pose is not None:
            record.auxiliary_position[row] = command.pose.position
            record.auxiliary_quaternion[row] = quaternion_from_rotation(command.pose.orientation)
        if np.isfinite(record.grasp_force[row]):
            record.friction[row] = self.regulator.learned_friction
            record.slip_evidence[row] = self.regulator.slip_likelihood
            record.grip[row] = self.regulator.state

    def pass_back(self) -> None:
        """Forward to the regulator whether touch is rejected and whether the joints are held."""
        self.regulator.reject_touch(self.controller.touch_rejected)
        self.regulator.joints_held = self.controller.joints_held


@dataclass
class SensingChain(Chain):
    """From true contacts to torques: the simulated skin, followed by a `Chain`."""

    sensor: TactileSensor

    def sense(self, stamp: int, state: PlantState) -> tuple[TactileReading, Answer]:
        """Return the tactile reading at a tick [ns] and the answer to it."""
        if state.palm is not None:
            self.controller.turn_palm(state.palm)
        touch = self.sensor.step(stamp, state.touch, state.speeds, state.joints.theta)
        return touch, self.answer(stamp, state.joints, touch.contacts, touch.forces)


class ClosedLoop:
    """Plant, sensor, regulator, optimizer and controller of one scenario.

    A tick runs them in the order of the messages. Contacts are converted to quaternions and back,
    as on the topics, so the ROS graph in lockstep gives bit-identical numbers.

    Attributes:
        scenario: The scenario.
        plant: Hand and object.
        chain: The other blocks.
        state: Hand and object at the current tick.
        stamp: The current tick [ns].
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build all blocks.

        Raises:
            TactileHandError: If hand, object or grasp cannot be built, or `check_scenario` rejects
                the scenario.
        """
        check_scenario(scenario)
        self.scenario = scenario
        self.plant = make_plant(scenario.plant)
        hand = self.plant.model  # the nominal one, which the controllers know
        self.chain = SensingChain(
            SlipRegulator(scenario.slip_regulator),
            ForceOptimizer(scenario.force_optimizer, hand.fingers),
            Controller(scenario.manipulation_controller),
            TactileSensor(scenario.tactile_sensor, hand.radii, hand),
        )
        self.state = self.plant.state
        self.stamp = 0
        self._requests = sorted(scenario.user_forces, key=lambda request: request.time)
        self._desired = np.full(3, np.nan), np.full(4, np.nan)
        for target in scenario.targets:
            self.controller.targets.command(target.target(), target.stamp)

    @property
    def regulator(self) -> SlipRegulator:
        """The slip regulator."""
        return self.chain.regulator

    @property
    def optimizer(self) -> ForceOptimizer:
        """The force optimizer."""
        return self.chain.optimizer

    @property
    def controller(self) -> Controller:
        """The manipulation controller."""
        return self.chain.controller

    def run(self, ticks: int | None = None) -> Record:
        """Run to the end of the scenario, or for a number of ticks, and return the record.

        If the simulation diverges, it ends early, with the object dropped.
        """
        ticks = self.scenario.ticks if ticks is None else ticks
        hand = self.plant.hand
        record = Record.empty(ticks, hand.finger_names, hand.joint_names)
        for row in range(ticks):
            try:
                self.tick(record, row)
            except DivergedError:
                record.true_positions[row] = record.contact_positions[row] = np.nan
                record.forces[row] = 0.0
                return record.part(slice(row + 1))
        return record

    def tick(self, record: Record, row: int) -> None:
        """Run one tick and write it into a row of the record."""
        self.advance(self.answer(record, row).torque)

    def advance(self, torque: Array) -> None:
        """Advance the plant by one tick with a torque, shape (m,), N m."""
        self.drive(lambda since, theta, rates: torque)

    def drive(self, torque_of: Callable[[int, Array, Array], Array]) -> None:
        """Advance the plant by one tick with the torques of a drive; see `Plant.drive`."""
        self.state = self.plant.drive(torque_of)
        self.stamp += self.scenario.plant.tick

    def answer(self, record: Record, row: int) -> Command:
        """Return the controller's answer to the current tick, and write both into a row."""
        while self._requests and self._requests[0].stamp <= self.stamp:
            self.regulator.request(self._requests.pop(0).force)
        state = self.state
        touch, answer = self.chain.sense(self.stamp, state)
        record.stamps[row] = self.stamp
        if state.palm is not None:
            record.palm[row] = state.palm
        record.theta[row], record.rates[row], record.torque[row] = state.joints
        record.contact_positions[row], record.contact_quaternions[row], record.forces[row] = touch
        record.object_position[row] = state.position
        record.object_quaternion[row] = quaternion_from_rotation(state.rotation)
        true = record.true_positions, record.true_quaternions, record.true_forces
        for column, value in zip(true, state.touch, strict=True):
            column[row] = value
        record.true_sliding[row], record.true_slid[row] = state.speeds, state.slid
        self.chain.write(record, row, answer)
        target = self.controller.targets.accepted
        if target is not None:
            self._desired = target.position, target.quaternion
        record.desired_position[row], record.desired_quaternion[row] = self._desired
        return answer.command
