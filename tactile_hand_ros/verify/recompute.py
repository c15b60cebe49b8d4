# SPDX-License-Identifier: Apache-2.0
"""Recomputation: feed the recorded sensor topics to the controllers again, in-process.

Every number must match the recording bit for bit. With another law, the differences show how that
law would have answered the same ticks; its answers do not move the hand.

Desired poses, grasp forces, live parameters and service calls are applied at their recorded ticks.
"""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.loop import Chain
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Command, Controller, Mode
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, OptimalForces, Status
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import BagError, GraspError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify.recorded_inputs import (
    CONTROLLERS,
    OF_LAW,
    PARAMETERS,
    Change,
    Inputs,
    read_inputs,
)

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
"""Compared quantities: topic, array of the record, unit."""

COLUMNS = ("topic", "ticks", "identical", "first difference", "largest difference")


@dataclass(frozen=True)
class Comparison:
    """One topic, recorded and recomputed."""

    topic: str
    unit: str
    compared: int  # ticks with a recorded message
    identical: int  # those that match bit for bit
    first: int | None  # the first tick that differs, ns
    largest: float  # difference; NaN where only one of the two has an answer

    @property
    def same(self) -> bool:
        """Whether all ticks are identical."""
        return self.compared == self.identical

    @property
    def row(self) -> list[str]:
        """Cells of a table, columns as in `COLUMNS`."""
        first = "" if self.first is None else f"{1e-9 * self.first:.3f} s"
        apart = "none" if self.same else f"{self.largest:.3g} {self.unit}"
        apart = "only one has an answer" if np.isnan(self.largest) else apart
        return [self.topic, str(self.compared), str(self.identical), first, apart]


def recompute(run: Run, law: str = "") -> list[Comparison]:
    """Recompute the controllers' answers from the sensor topics of a run, and compare both.

    `law` replaces the recorded one. A user's own law must be given even if it is the recorded one,
    because a recording imports no code.

    Raises:
        BagError: If the scenario is unknown.
        TactileHandError: If the law cannot be used.
    """
    if run.scenario is None:
        reason = run.scenario_problem or "the bag does not contain it"
        raise BagError(
            f"The configuration of {run.bag} is unknown ({reason}); record with `scenario`, or put "
            "scenario.yaml next to the bag."
        )
    scenario = run.scenario.changed({"law": law} if law else {})
    record = ShadowLoop(read_inputs(run, scenario, of_scenario=OF_LAW if law else ())).run()
    return compare(run.record, record)


def compare(recorded: Record, other: Record) -> list[Comparison]:
    """Compare the answers of controllers, tick by tick."""
    return [_compare(recorded, other, *quantity) for quantity in COMPARED]


def _compare(recorded: Record, other: Record, topic: str, name: str, unit: str) -> Comparison:
    n = len(recorded)
    a, b = (np.ascontiguousarray(getattr(r, name).reshape(n, -1)) for r in (recorded, other))
    unknown = np.isnan(a) & np.isnan(b)
    same = (a.view(np.int64) == b.view(np.int64)) | unknown
    compared = int((~unknown.all(axis=1)).sum())
    rows = np.flatnonzero(~same.all(axis=1))
    gaps = np.abs(a[rows] - b[rows])
    gaps = gaps[np.isfinite(gaps)]
    largest = float(gaps.max()) if len(gaps) else (np.nan if len(rows) else 0.0)
    first = int(recorded.stamps[rows[0]]) if len(rows) else None
    return Comparison(topic, unit, compared, compared - len(rows), first, largest)


class ShadowLoop(Chain):
    """The chain of controllers of `ClosedLoop`, fed from a recording."""

    def __init__(self, inputs: Inputs) -> None:
        """Build the controllers; raise TactileHandError if the hand cannot be built."""
        r, k = inputs.record, len(inputs.record.finger_names)
        self._inputs = inputs
        self._waiting = {node: deque(inputs.changes[node]) for node in CONTROLLERS}
        first = {node: changes.popleft().value for node, changes in self._waiting.items()}
        blocks: tuple[Any, ...] = (
            SlipRegulator(first[names.REGULATOR]),
            ForceOptimizer(first[names.OPTIMIZER], k),
            Controller(first[names.CONTROLLER]),
        )
        self._blocks = dict(zip(CONTROLLERS, blocks, strict=True))
        nothing = (
            np.nan,
            OptimalForces(Status.CONTACT_MISSING, "skipped", np.full((k, 3), np.nan)),
            Command(np.full(r.theta.shape[1], np.nan), Mode.HOLD, None),
        )
        answers = (r.grasp_force, r.optimal_forces, r.command)
        ticks = [set(r.stamps[inputs.answered(each)].tolist()) for each in answers]
        wrapped: Any = map(_AtItsTicks, blocks, ticks, nothing)
        super().__init__(*wrapped)
        self._drives = inputs.answered(r.command)
        unknown = {name: np.full_like(getattr(r, name), np.nan) for _, name, _ in COMPARED}
        self._out = replace(r, **unknown)

    def run(self) -> Record:
        """Answer all ticks."""
        r = self._inputs.record
        for row, contacts in enumerate(self._inputs.contacts):
            stamp = int(r.stamps[row])
            touched = contacts is not None and bool(self._inputs.measured[row])
            if contacts is not None and touched:
                self._answer(row, contacts)
            elif contacts is not None and not self.optimizer.config.cones:
                self._change(names.OPTIMIZER, stamp)
                self._out.optimal_forces[row] = self.optimizer.step(stamp, contacts).forces
            drives = touched and bool(self._drives[row])
            if not drives and np.isfinite(r.command[row]).all():
                self._hold(row)
        return self._out

    def pass_back(self) -> None:
        """Do nothing; the recorded rejections are applied instead."""

    def _answer(self, row: int, contacts: Contacts) -> None:
        r = self._inputs.record
        stamp = int(r.stamps[row])
        for node in CONTROLLERS:
            self._change(node, stamp)
        if np.isfinite(r.palm[row]).all():
            self._blocks[names.CONTROLLER].turn_palm(r.palm[row])
        seen = self._joints(row), contacts, r.forces[row]
        self.write(self._out, row, self.answer(stamp, *seen))

    def _hold(self, row: int) -> None:
        r = self._inputs.record
        stamp, why = int(r.stamps[row]), "inputs are missing"
        self._change(names.CONTROLLER, stamp)
        held = self.controller.hold(self._joints(row), why, stamp=stamp)
        self._out.command[row] = held.torque

    def _joints(self, row: int) -> Joints:
        r = self._inputs.record
        torque = r.torque[row] if np.isfinite(r.torque[row]).all() else None  # not reported
        return Joints(r.theta[row], r.rates[row], torque)

    def _change(self, node: str, stamp: int) -> None:
        """Apply the changes of a node up to a tick [ns]."""
        waiting = self._waiting[node]
        while waiting and waiting[0].stamp <= stamp:
            _apply(waiting.popleft(), node, self._blocks[node])


def _apply(change: Change, node: str, block: Any) -> None:
    name, value = change.name, change.value
    if name == PARAMETERS:
        block.configure(value)
    elif name == names.TOUCH_REJECTED:
        block.reject_touch(value)
    elif name == names.GRASP_FORCE:
        limits = block.config  # changed since, perhaps
        block.request(min(max(value, limits.minimum), limits.maximum))
    elif name == names.DESIRED_POSE:
        block.targets.schedule(value, change.stamp, judged=True)
    elif name == "reset":
        block.forget() if node == names.CONTROLLER else block.reset()
    elif name == "enable":
        block.enabled = value
    elif name == names.JOINT_HOLD:
        block.joints_held = value
    else:
        with contextlib.suppress(GraspError):  # another law may not have had a grasp
            block.grasp() if value else block.release()


class _AtItsTicks:
    """A block that answers only the ticks that its node answered.

    The regulator, from its first answer on, also processes those that it is too slow to answer.
    """

    def __init__(self, block: Any, ticks: set[int], nothing: Any) -> None:
        self._block, self._ticks, self._nothing = block, ticks, nothing
        self._measures = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)

    def step(self, stamp: int, *inputs: Any) -> Any:
        """Return the block's answer, or the placeholder at a tick that the node did not answer."""
        is_answered = stamp in self._ticks
        self._measures |= is_answered and isinstance(self._block, SlipRegulator)
        answer = self._block.step(stamp, *inputs) if is_answered or self._measures else None
        return answer if is_answered else self._nothing
