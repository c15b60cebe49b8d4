# SPDX-License-Identifier: Apache-2.0
"""The five blocks wired by function calls: the paper without ROS, and the oracle for the graph."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.controller import Command, Controller
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, OptimalForces
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.rotations import quaternions_of_rows
from tactile_hand_ros.scenario.scenario import Scenario
from tactile_hand_ros.simulation.belief import Belief
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.skin import TactileReading, TactileSensor
from tactile_hand_ros.simulation.truth import sliding_speeds, true_reading

Array = NDArray[np.float64]


class ClosedLoop:
    """Plant, sensor, regulator, optimizer and controller of one scenario.

    A tick runs them in the order in which messages travel: touch is sampled, k_f and f* follow from
    it, the controller answers, and the plant moves on with that torque. Contacts pass through the
    quaternions of the topics, so that the ROS graph in lockstep gives the same numbers to the bit.

    Attributes:
        state: Hand and object at the present tick.
        stamp: The present tick, ns.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build all blocks.

        Raises:
            TactileHandError: If hand, object or grasp cannot be built.
        """
        self.scenario = scenario
        self.plant = Plant(scenario.plant)
        hand = self.plant.known
        self.sensor = TactileSensor(scenario.tactile_sensor, hand.radii)
        calibration = scenario.tactile_sensor.calibration
        self._belief = None if calibration.is_right else Belief(calibration, hand)
        self.regulator = SlipRegulator(scenario.slip_regulator, hand.fingers)
        self.optimizer = ForceOptimizer(scenario.force_optimizer, hand.fingers)
        self.controller = Controller(scenario.manipulation_controller)
        self.state = self.plant.state
        self.stamp = 0
        self._requests = sorted(scenario.user_forces, key=lambda request: request.time)
        self._desired: tuple[Array, Array] | None = None
        self._targets = list(scenario.targets)
        for target in scenario.targets:
            self.controller.command(target.target(), target.stamp)

    def run(
        self, ticks: int | None = None, progress: Callable[[int], None] | None = None
    ) -> Record:
        """Run to the end of the scenario, or for a number of ticks.

        Args:
            ticks: Number of ticks; that of the scenario by default.
            progress: Called with the number of finished ticks, a hundred times in a run.
        """
        ticks = self.scenario.ticks if ticks is None else ticks
        hand = self.plant.hand
        record = Record.empty(ticks, hand.finger_names, hand.joint_names)
        for row in range(ticks):
            self.tick(record, row)
            if progress is not None and (row + 1) % max(1, ticks // 100) == 0:
                progress(row + 1)
        return record

    def tick(self, record: Record, row: int) -> None:
        """Run one tick and write it into a row of the record."""
        self.advance(self.answer(record, row).torque)

    def advance(self, torque: Array) -> None:
        """Move the plant one tick ahead with a torque, shape (m,), N m."""
        self.state = self.plant.advance(torque)
        self.stamp += self.scenario.plant.tick

    def answer(self, record: Record, row: int) -> Command:
        """Return the controller's answer to the present tick, and write both into a row."""
        state, stamp = self.state, self.stamp
        true = true_reading(state)
        self._ask()
        sliding = sliding_speeds(state)
        seen = true if self._belief is None else self._belief.step(state.theta, true)
        touch = self.sensor.step(stamp, seen, sliding)
        contacts = touch.contacts
        self.pass_on_rejection()
        grasp_force = self.regulator.step(stamp, contacts, touch.forces)
        friction = self.regulator.learned_friction
        optimal = self.optimizer.step(stamp, contacts, friction, touch.forces)
        command = self.controller.step(
            stamp,
            state.theta,
            state.rates,
            contacts,
            optimal.forces,
            grasp_force,
            touch.forces,
            state.torque,
        )
        self._write(record, row, true, touch, grasp_force, optimal, command)
        record.true_sliding[row] = sliding
        return command

    def pass_on_rejection(self) -> None:
        """Let regulator and optimizer know whether the controller doubted the last touch."""
        self.regulator.reject_touch(self.controller.touch_rejected)
        self.optimizer.reject_touch(self.controller.touch_rejected)

    def _ask(self) -> None:
        """Pass on what the user asks for at this tick."""
        while self._requests and self._requests[0].stamp <= self.stamp:
            self.regulator.request(self._requests.pop(0).force)

    def _write(
        self,
        record: Record,
        row: int,
        true: TactileReading,
        touch: TactileReading,
        grasp_force: float,
        optimal: OptimalForces,
        command: Command,
    ) -> None:
        state = self.state
        record.stamps[row] = self.stamp
        record.theta[row], record.rates[row] = state.theta, state.rates
        record.torque[row], record.command[row] = state.torque, command.torque
        record.contact_positions[row] = touch.positions
        record.contact_quaternions[row] = touch.quaternions
        record.forces[row] = touch.forces
        record.optimal_forces[row] = optimal.forces
        record.grasp_force[row] = grasp_force
        if command.pose is not None:
            record.auxiliary_position[row] = command.pose.position
            record.auxiliary_quaternion[row] = _quaternion(command.pose.orientation)
        self._write_desired(record, row)
        record.object_position[row] = state.position
        record.object_quaternion[row] = _quaternion(state.rotation)
        record.true_positions[row], record.true_quaternions[row] = true.positions, true.quaternions
        record.true_forces[row] = true.forces
        record.true_slid[row] = state.slid
        record.friction[row] = self.regulator.learned_friction
        record.slip_evidence[row] = self.regulator.slip_likelihood
        record.grip[row] = self.regulator.state

    def _write_desired(self, record: Record, row: int) -> None:
        while self._targets and self._targets[0].stamp <= self.stamp:
            target = self._targets.pop(0).target()
            self._desired = target.position, _quaternion(target.orientation)
        if self._desired is not None:
            record.desired_position[row], record.desired_quaternion[row] = self._desired


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion of a rotation, shape (1, 4)."""
    return quaternions_of_rows(rotation.reshape(1, 9))
