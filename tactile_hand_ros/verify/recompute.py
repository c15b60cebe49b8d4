# SPDX-License-Identifier: Apache-2.0
"""Recomputation: the recorded sensor topics once more through the controllers, in-process.

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
from tactile_hand_ros.closed_loop.loop import Chain
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Command, Controller, Mode
from tactile_hand_ros.control.laws import LawFactory
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, OptimalForces, Status
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import BagError, ConfigurationError, GraspError
from tactile_hand_ros.rotations import quaternion_from_rotation
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, changed
from tactile_hand_ros.verify.recorded_inputs import (
    CONTROLLERS,
    Effects,
    Inputs,
    ServiceCall,
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
    """The chain of controllers of `ClosedLoop`, fed from a recording."""

    def __init__(self, inputs: Inputs, law: LawFactory | None = None) -> None:
        """Build the controllers.

        Args:
            inputs: Their configurations, inputs and commands.
            law: A law in the place of the configured one.

        Raises:
            TactileHandError: If the hand cannot be built.
        """
        self._inputs = inputs
        k = len(inputs.record.finger_names)
        changes = {node: _Changes(inputs, node) for node in CONTROLLERS}
        self._controller = _Controller(changes[names.CONTROLLER], Effects(inputs.poses), law)
        self._optimizer = _Optimizer(changes[names.OPTIMIZER], k)
        self._regulator = _Regulator(changes[names.REGULATOR], Effects(inputs.forces), k)
        self._chain = Chain(self._regulator, self._optimizer, self._controller)
        self._out = copy.copy(inputs.record)
        for name in _ANSWERS:  # the copy is not shared yet
            object.__setattr__(self._out, name, np.full_like(getattr(self._out, name), np.nan))

    def run(self) -> Record:
        """Answer all ticks."""
        r, answered, felt = self._inputs.record, self._inputs.answered, self._inputs.felt
        for block, answers in (
            (self._regulator, r.grasp_force),
            (self._optimizer, r.optimal_forces),
            (self._controller, r.command),
        ):
            block.answered = dict(zip(r.stamps.tolist(), answered(answers).tolist(), strict=True))
        for row, contacts in enumerate(self._inputs.contacts):
            touched = contacts is not None and bool(felt[row])
            if contacts is not None and touched:
                self._answer(row, contacts)
            elif contacts is not None and not self._optimizer.config.cones:
                optimal = self._optimizer.step(int(r.stamps[row]), contacts)
                self._out.optimal_forces[row] = optimal.forces
            drives = touched and self._controller.answered[int(r.stamps[row])]
            if not drives and np.isfinite(r.command[row]).all():
                self._hold(row)
        return self._out

    def _answer(self, row: int, contacts: Contacts) -> None:
        r, out, regulator = self._inputs.record, self._out, self._regulator
        stamp = int(r.stamps[row])
        grasp_force, optimal, command = self._chain.answer(
            stamp, r.theta[row], r.rates[row], r.torque[row], contacts, r.forces[row]
        )
        out.grasp_force[row], out.optimal_forces[row] = grasp_force, optimal.forces
        if regulator.answered[stamp]:
            out.grip[row], out.slip_evidence[row] = regulator.state, regulator.slip_likelihood
            out.friction[row] = regulator.learned_friction
        out.command[row] = command.torque
        if command.pose is not None:
            out.auxiliary_position[row] = command.pose.position
            out.auxiliary_quaternion[row] = quaternion_from_rotation(command.pose.orientation)

    def _hold(self, row: int) -> None:
        r = self._inputs.record
        self._controller.change(int(r.stamps[row]))
        held = self._controller.hold(
            r.theta[row], r.rates[row], "inputs are missing", applied=r.torque[row]
        )
        self._out.command[row] = held.torque


class _Changes:
    """What changed a node of a recorded run besides its inputs."""

    def __init__(self, inputs: Inputs, node: str) -> None:
        self.configs = Effects(inputs.configurations[node])
        self.requests = Effects(inputs.requests.get(node, ()))
        self.first = self.configs.first()


class _Regulator(SlipRegulator):
    """The regulator, changed as in the recorded run."""

    def __init__(self, changes: _Changes, asked: Effects, fingers: int) -> None:
        super().__init__(changes.first, fingers)
        self._changes, self._forces = changes, asked
        self.answered: dict[int, bool] = {}
        self._started = False

    def step(
        self, stamp: int, contacts: Contacts | None = None, forces: Array | None = None
    ) -> float:
        """Return k_f; a tick that the node was too slow to answer it has felt all the same."""
        answered = self.answered[stamp]
        self._started = self._started or answered  # the first tick that it gets is answered
        if not self._started:
            return np.nan
        for config in self._changes.configs.until(stamp):
            self.configure(config)
        for request in self._changes.requests.until(stamp):
            if request.service == names.TOUCH_REJECTED:
                super().reject_touch(request.value)
            else:
                self.reset()
        for force in self._forces.until(stamp):
            self.goal = force
        grasp_force = super().step(stamp, contacts, forces)
        return grasp_force if answered else np.nan

    def reject_touch(self, rejected: bool) -> None:
        """Do nothing: the recorded rejections count."""


class _Optimizer(ForceOptimizer):
    """The optimizer, changed as in the recorded run."""

    def __init__(self, changes: _Changes, fingers: int) -> None:
        super().__init__(changes.first, fingers)
        self._changes = changes
        self.answered: dict[int, bool] = {}

    def step(
        self,
        stamp: int,
        contacts: Contacts,
        friction: Array | None = None,
        forces: Array | None = None,
    ) -> OptimalForces:
        """Return f*, none at a tick that the node has skipped."""
        if not self.answered[stamp]:
            none = np.full((len(contacts.positions), 3), np.nan)
            return OptimalForces(Status.CONTACT_MISSING, "skipped", none)
        for config in self._changes.configs.until(stamp):
            self.configure(config)
        for request in self._changes.requests.until(stamp):
            super().reject_touch(request.value)
        return super().step(stamp, contacts, friction, forces)

    def reject_touch(self, rejected: bool) -> None:
        """Do nothing: the recorded rejections count."""


class _Controller(Controller):
    """The controller, changed as in the recorded run."""

    def __init__(self, changes: _Changes, poses: Effects, law: LawFactory | None) -> None:
        super().__init__(changes.first, law)
        self._changes, self._poses = changes, poses
        self.answered: dict[int, bool] = {}

    def step(
        self,
        stamp: int,
        theta: Array,
        rates: Array,
        contacts: Contacts,
        optimal_forces: Array,
        grasp_force: float,
        forces: Array | None = None,
        applied: Array | None = None,
    ) -> Command:
        """Return the torques, none at a tick that the node has skipped."""
        if not self.answered[stamp]:
            return Command(np.full(len(theta), np.nan), Mode.HOLD, None)
        self.change(stamp)
        return super().step(
            stamp, theta, rates, contacts, optimal_forces, grasp_force, forces, applied
        )

    def change(self, stamp: int) -> None:
        """Apply what took effect at a tick [ns]."""
        for config in self._changes.configs.until(stamp):
            self.configure(config)
        for request in self._changes.requests.until(stamp):
            self._apply(request)
        for target in self._poses.until(stamp):
            self.schedule(target, stamp, judged=True)

    def _apply(self, request: ServiceCall) -> None:
        """Repeat a service call."""
        if request.service == "reset":
            self.forget()
        elif request.service == "enable":
            self.enabled = request.value
        elif request.service == names.JOINT_HOLD:
            self.joints_held = request.value
        elif request.value:
            self.grasp()
        else:
            with contextlib.suppress(GraspError):  # a shadow controller need not have had a grasp
                self.release()


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
