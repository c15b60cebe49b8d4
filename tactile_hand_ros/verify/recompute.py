# SPDX-License-Identifier: Apache-2.0
"""Recomputation: the recorded sensor topics once more through the controllers, by function calls.

With the configuration of the run every number must come out as it was recorded, to the bit. With
another configuration or law the difference shows what that controller would have answered at the
same ticks (a shadow controller: its answers do not move the hand).

Desired poses, squeezes, live parameters and service calls are applied at the ticks at which the
nodes published that they took effect.
"""

from __future__ import annotations

import contextlib
import copy
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.laws import LawFactory
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import BagError, ConfigurationError, GraspError
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, changed
from tactile_hand_ros.verify.recorded_inputs import (
    CONTROLLERS,
    Effects,
    Inputs,
    Request,
    read_inputs,
)

Array = NDArray[np.float64]

COMPARED = (
    ("grasp_force", "grasp_force", "N"),
    ("grip_state", "friction", "1"),
    ("grip_state, evidence", "slip_evidence", "1"),
    ("grip_state, grip", "grip", "1"),
    ("optimal_force", "optimal_forces", "1"),
    ("auxiliary_pose, position", "auxiliary_position", "m"),
    ("auxiliary_pose, orientation", "auxiliary_quaternion", "1"),
    ("joint_command", "command", "N m"),
)
"""What is compared: topic, array of the record, unit."""


@dataclass(frozen=True)
class Comparison:
    """One topic, recorded and recomputed.

    Attributes:
        topic: Its relative name.
        unit: Unit of the difference.
        compared: Number of ticks with a recorded message.
        identical: Number of those that are equal to the bit.
        first: Stamp of the first tick that differs in ns, None if there is none.
        largest: Largest difference; NaN where only one of both has an answer.
    """

    topic: str
    unit: str
    compared: int
    identical: int
    first: int | None
    largest: float

    @property
    def same(self) -> bool:
        """Whether all ticks are identical."""
        return self.compared == self.identical


@dataclass(frozen=True)
class Recomputation:
    """What came out.

    Attributes:
        record: The run as recomputed; what controllers do not answer is as recorded.
        comparisons: Topic by topic.
        scenario: The configuration that was used.
        simulated: Time of the run, s.
        seconds: Time that the controllers needed for it, s.
    """

    record: Record
    comparisons: list[Comparison]
    scenario: Scenario
    simulated: float
    seconds: float

    @property
    def same(self) -> bool:
        """Whether everything is identical."""
        return all(comparison.same for comparison in self.comparisons)

    @property
    def speed(self) -> float:
        """How many times faster than real time it was."""
        return self.simulated / self.seconds if self.seconds > 0.0 else float("inf")


def recompute(
    run: Run, changes: Mapping[str, Any] | None = None, law: LawFactory | None = None
) -> Recomputation:
    """Feed the sensor topics of a run through the controllers.

    Args:
        run: The run; its scenario must be known.
        changes: Other values by dotted key; that of a controller may go without its node's name.
        law: Another law in the place of the configured one.

    Raises:
        BagError: If the scenario is not known.
        TactileHandError: If a change is refused.
    """
    base = scenario_of(run)
    wanted = changed(base, {full_key(key): value for key, value in (changes or {}).items()})
    inputs = read_inputs(run, base).changed(base, wanted)
    began = time.perf_counter()
    record = ShadowLoop(inputs, law).run()
    seconds = time.perf_counter() - began
    simulated = float(record.times[-1] - record.times[0]) if len(record) else 0.0
    return Recomputation(record, compare(run.record, record), wanted, simulated, seconds)


def scenario_of(run: Run) -> Scenario:
    """Return the scenario of a run.

    Raises:
        BagError: If the bag does not hold it, or holds one of another version.
    """
    if run.scenario is None:
        reason = run.scenario_problem or "the bag does not hold it"
        raise BagError(
            f"The configuration of {run.bag} is needed but not known ({reason}); record with "
            "`scenario`, or put scenario.yaml beside the bag."
        )
    return run.scenario


def full_key(key: str) -> str:
    """Return the dotted key of a scenario for one that may begin inside a controller.

    Raises:
        ConfigurationError: If several controllers have such a value.
    """
    first = key.split(".")[0]
    if first in Scenario.model_fields:
        return key
    owners = [
        node
        for node in CONTROLLERS
        if first in getattr(Scenario.model_fields[node].annotation, "model_fields", {})
    ]
    if len(owners) > 1:
        raise ConfigurationError(
            f"'{key}' may mean {' or '.join(f'{owner}.{key}' for owner in owners)}; say which"
        )
    return f"{owners[0]}.{key}" if owners else key


def reason(run: Run) -> str:
    """Return in words what may be the reason that a run is not reproduced."""
    data = run.summary.custom_data
    others = [
        f"{name} {data[f'version_{name}']} then, {version} now"
        for name, version in versions().items()
        if data.get(f"version_{name}", version) != version
    ]
    if others:
        return f": {'; '.join(others)}."
    if int(data.get("lost_messages", 0)):
        return f": {data['lost_messages']} messages are missing from the bag."
    return "; changed code, or a node that was started again, may be the reason."


def compare(recorded: Record, other: Record) -> list[Comparison]:
    """Compare the answers of controllers, tick by tick."""
    return [
        _compare(topic, unit, recorded.stamps, getattr(recorded, name), getattr(other, name))
        for topic, name, unit in COMPARED
    ]


def _compare(
    topic: str, unit: str, stamps: NDArray[np.int64], recorded: Array, other: Array
) -> Comparison:
    a = np.ascontiguousarray(recorded.reshape(len(stamps), -1))
    b = np.ascontiguousarray(other.reshape(len(stamps), -1))
    same = (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))
    known = ~(np.isnan(a).all(axis=1) & np.isnan(b).all(axis=1))
    differs = known & ~same.all(axis=1)
    rows = np.flatnonzero(differs)
    gaps = np.abs(a[rows] - b[rows])
    gaps = gaps[np.isfinite(gaps)]
    largest = float(gaps.max()) if len(gaps) else (np.nan if len(rows) else 0.0)
    first = int(stamps[rows[0]]) if len(rows) else None
    return Comparison(topic, unit, int(known.sum()), int(known.sum()) - len(rows), first, largest)


class ShadowLoop:
    """The controllers, wired by function calls as in `ClosedLoop`, fed from a recording."""

    def __init__(self, inputs: Inputs, law: LawFactory | None = None) -> None:
        """Build the controllers.

        Args:
            inputs: Their configurations, inputs and commands.
            law: A law in the place of the configured one.

        Raises:
            TactileHandError: If the hand cannot be built.
        """
        self._inputs = inputs
        self._recorded = inputs.record
        k = len(self._recorded.finger_names)
        self._configurations = {node: Effects(e) for node, e in inputs.configurations.items()}
        self._requests = {node: Effects(inputs.requests.get(node, ())) for node in CONTROLLERS}
        self._poses, self._forces = Effects(inputs.poses), Effects(inputs.forces)
        first = {node: effects.first() for node, effects in self._configurations.items()}
        self._regulator = SlipRegulator(first[names.REGULATOR], k)
        self._optimizer = ForceOptimizer(first[names.OPTIMIZER], k)
        self._controller = Controller(first[names.CONTROLLER], law)
        arrays = {name: np.full_like(getattr(self._recorded, name), np.nan) for name in _ANSWERS}
        self._out = copy.copy(self._recorded)
        for name, array in arrays.items():
            object.__setattr__(self._out, name, array)  # the copy is not shared yet

    def run(self) -> Record:
        """Answer all ticks."""
        r, answered = self._recorded, self._inputs.answered
        regulated, optimized = answered(r.grasp_force), answered(r.optimal_forces)
        controlled = answered(r.command)
        begins = np.logical_or.accumulate(regulated)  # the first tick that it gets is answered
        for row in range(len(r)):
            contacts = self._inputs.contacts[row]
            touched = contacts is not None and bool(self._inputs.felt[row])
            if touched and begins[row]:
                self._regulate(row, is_answered=bool(regulated[row]))
            if contacts is not None and optimized[row]:
                if touched or not self._optimizer.config.cones:
                    self._optimize(row, contacts)
            if touched and controlled[row]:
                self._control(row)
            elif np.isfinite(self._recorded.command[row]).all():
                self._hold(row)
        return self._out

    def _regulate(self, row: int, *, is_answered: bool) -> None:
        """Let the regulator feel a tick; one that it was too slow to answer it feels, too."""
        contacts, out, regulator = self._inputs.contacts[row], self._out, self._regulator
        stamp = int(self._recorded.stamps[row])
        for config in self._configurations[names.REGULATOR].until(stamp):
            regulator.configure(config)
        for request in self._requests[names.REGULATOR].until(stamp):
            if request.service == names.TOUCH_REJECTED:
                regulator.reject_touch(request.value)
            else:
                regulator.reset()
        for force in self._forces.until(stamp):
            regulator.goal = force
        grasp_force = regulator.step(stamp, contacts, self._recorded.forces[row])
        if not is_answered:
            return
        out.grasp_force[row] = grasp_force
        out.grip[row], out.slip_evidence[row] = regulator.state, regulator.slip_likelihood
        out.friction[row] = regulator.learned_friction

    def _optimize(self, row: int, contacts: Contacts) -> None:
        stamp = int(self._recorded.stamps[row])
        for config in self._configurations[names.OPTIMIZER].until(stamp):
            self._optimizer.configure(config)
        for request in self._requests[names.OPTIMIZER].until(stamp):
            self._optimizer.reject_touch(request.value)
        friction, forces = self._out.friction[row], self._recorded.forces[row]
        optimal = self._optimizer.step(stamp, contacts, friction, forces)
        self._out.optimal_forces[row] = optimal.forces

    def _control(self, row: int) -> None:
        r, out = self._recorded, self._out
        contacts = self._inputs.contacts[row]
        assert contacts is not None
        self._command(int(r.stamps[row]))
        command = self._controller.step(
            int(r.stamps[row]),
            r.theta[row],
            r.rates[row],
            contacts,
            out.optimal_forces[row],
            float(out.grasp_force[row]),
            r.forces[row],
            r.torque[row],
        )
        out.command[row] = command.torque
        pose = command.pose
        if pose is None:
            out.auxiliary_position[row] = out.auxiliary_quaternion[row] = np.nan
        else:
            out.auxiliary_position[row] = pose.position
            out.auxiliary_quaternion[row] = quaternion_from_rotation(pose.orientation)

    def _hold(self, row: int) -> None:
        r = self._recorded
        self._command(int(r.stamps[row]))
        held = self._controller.hold(
            r.theta[row], r.rates[row], "inputs are missing", applied=r.torque[row]
        )
        self._out.command[row] = held.torque

    def _command(self, stamp: int) -> None:
        """Give the controller what took effect at a tick."""
        controller = self._controller
        for config in self._configurations[names.CONTROLLER].until(stamp):
            controller.configure(config)
        for request in self._requests[names.CONTROLLER].until(stamp):
            _apply(controller, request)
        for target in self._poses.until(stamp):
            controller.schedule(target, stamp, judged=True)


def _apply(controller: Controller, request: Request) -> None:
    """Repeat a service call."""
    if request.service == "reset":
        controller.forget()
    elif request.service == "enable":
        controller.enabled = request.value
    elif request.service == names.JOINT_HOLD:
        controller.joints_held = request.value
    elif request.value:
        controller.grasp()
    else:
        with contextlib.suppress(GraspError):  # a shadow controller need not have had a grasp
            controller.release()


_ANSWERS = tuple(name for _, name, _ in COMPARED)

COLUMNS = ("topic", "ticks", "identical", "first that differs", "largest difference")


def rows(comparisons: list[Comparison]) -> list[list[str]]:
    """Return comparisons as text, columns as in `COLUMNS`."""
    return [
        [
            c.topic,
            str(c.compared),
            str(c.identical),
            "" if c.first is None else f"{1e-9 * c.first:.3f} s",
            _difference(c),
        ]
        for c in comparisons
    ]


def _difference(c: Comparison) -> str:
    if c.same:
        return "none"
    return "only one has an answer" if np.isnan(c.largest) else f"{c.largest:.3g} {c.unit}"
