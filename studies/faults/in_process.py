# SPDX-License-Identifier: Apache-2.0
"""The same faults in-process: time advances at every tick, with or without an answer.

This is real time without a clock, so results are the same on every computer. The blocks are those
of the closed loop. The study adds faulty wires between them and a guard for the joints.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np

from studies.faults import space
from studies.faults.outcome import LET_GO, Outcome, distance
from studies.faults.situations import FAULT_TIME, SITUATIONS, scenario
from studies.faults.space import Injection
from studies.stalls import GuardedLoop
from tactile_hand_ros.closed_loop.loop import Answer, SensingChain
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.command_guard import TorqueCommand
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Command, Controller, Mode
from tactile_hand_ros.control.laws import Target
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import DivergedError, TactileHandError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.scenario.scenario import Scenario

DELAY = 0.1  # s
_KEPT = 10  # a slow wire passes one message in ten
_PULSE = 0.05  # s
_AFTER = 1.0  # s of observation after a fault
_FACTOR, _AWAY, _TURN, _JUMP = 3.0, 0.02, 0.2, 0.05  # wrong values: force factor, m, rad, m

_WIRES = {
    space.JOINTS: ("joints",),
    space.FINGER: ("force 0",),
    space.SKIN: ("contacts", "force"),
    space.REGULATOR: ("grasp force",),
    space.OPTIMIZER: ("shape",),
    space.CONTROLLER: ("torque",),
}


_NOTHING = Command(np.full(1, np.nan), Mode.HOLD, None, do_not_send=True)
"""Answer of a controller without inputs."""
_NO_JOINTS = Joints(np.empty(0), np.empty(0))


class Wires:
    """Wires between the blocks, some of which fail."""

    def __init__(self, run: Injection, tick: float) -> None:
        """Create wires for a fault and a tick [s]; they work until `failing` is set."""
        self.failing = False
        self._names = _WIRES.get(run.component, ())
        self._fault, self._chance, self._tick = run.fault, random.Random(run.seed), tick
        self._frozen: dict[str, Any] = {}
        self._count = 0
        self._is_on, self._left = True, 0.0

    def begin_tick(self) -> None:
        """Advance the time-dependent faults by a tick."""
        self._count += 1
        self._left -= self._tick
        if self._left <= 0.0:
            self._is_on = not self._is_on
            self._left = self._chance.expovariate(1.0 / _PULSE)

    def carry(self, name: str, value: Any, wrong: Callable[[Any], Any]) -> Any:
        """Return the received value, or None if it is lost."""
        if not self.failing or not name.startswith(self._names):
            return value
        if self._fault == "stuck":
            return self._frozen.setdefault(name, value)
        if self._fault == "wrong":
            return wrong(value)
        if self._fault == "slow":
            return None if self._count % _KEPT else value
        if self._fault == "intermittent":
            return value if self._is_on else None
        # Off; garbage, which every reader rejects; wrong timestamps, which match no tick.
        return value if self._fault in ("delayed", space.NONE) else None

    @property
    def delay(self) -> int:
        """Delay of an answer in ticks."""
        return round(DELAY / self._tick) if self.failing and self._fault == "delayed" else 0


class _Block:
    """A block of the loop behind wires; other attributes are those of the block."""

    def __init__(self, block: Any, wires: Wires) -> None:
        self.block, self._carry = block, wires.carry

    def __getattr__(self, name: str) -> Any:
        return getattr(self.block, name)


class _Regulator(_Block):
    @property
    def joints_held(self) -> bool:
        return bool(self.block.joints_held)

    @joints_held.setter
    def joints_held(self, held: bool) -> None:
        self.block.joints_held = held

    def step(
        self, stamp: int, joints: Joints, contacts: Contacts | None, forces: Array | None
    ) -> Any:
        is_missing = joints is _NO_JOINTS or contacts is None or forces is None
        answer = None if is_missing else self.block.step(stamp, joints, contacts, forces)
        return self._carry("grasp force", answer, lambda value: value and _FACTOR * value)


class _Optimizer(_Block):
    def step(
        self, stamp: int, contacts: Contacts | None, carried: CarriedLoad, grasp_force: float | None
    ) -> Any:
        shape = None
        if contacts is not None and grasp_force is not None:
            shape = self.block.step(stamp, contacts, carried, grasp_force).forces
        return SimpleNamespace(forces=self._carry("shape", shape, _swapped))


class _Controller(_Block):
    """The controller, which holds if inputs are missing for a timeout.

    Attributes:
        drives: Whether it drove the object at the last tick.
    """

    def __init__(self, block: Controller, wires: Wires, scenario: Scenario) -> None:
        super().__init__(block, wires)
        config = scenario.manipulation_controller
        self._timeout, self._tick = config.input_timeout, 1e-9 * scenario.plant.tick
        self._observes = config.law.observer.time > 0.0
        self._missing, self.drives = 0.0, True
        self.before_step: Callable[[], None] = lambda: None

    def step(
        self,
        stamp: int,
        joints: Joints,
        contacts: Contacts | None,
        shape: Array | None,
        grasp_force: float | None,
        forces: Array | None,
    ) -> Any:
        self.drives = True
        if joints is _NO_JOINTS:
            return _NOTHING
        is_missing = any(each is None for each in (contacts, grasp_force, shape))
        is_missing |= self._observes and forces is None
        self._missing = self._missing + self._tick if is_missing else 0.0
        if is_missing:
            why = "inputs are missing"
            answer = self.block.hold(joints, why, stamp=stamp)
            self.drives = False
            return answer if self._missing >= self._timeout else _NOTHING
        self.before_step()
        answer = self.block.step(stamp, joints, contacts, shape, grasp_force, forces)
        self.drives = answer.mode is Mode.DRIVE
        return answer


class FaultyChain(SensingChain):
    """The blocks of a loop with failing wires between them.

    Like its node, a block gives no answer if an input is missing.
    """

    def __init__(self, blocks: SensingChain, wires: Wires, scenario: Scenario) -> None:
        """Wrap the blocks of a loop."""
        controller: Any = _Controller(blocks.controller, wires, scenario)
        regulator: Any = _Regulator(blocks.regulator, wires)
        optimizer: Any = _Optimizer(blocks.optimizer, wires)
        super().__init__(regulator, optimizer, controller, blocks.sensor)
        self.plugged, self._carry = controller, wires.carry

    def answer(self, stamp: int, joints: Joints, contacts: Contacts, forces: Array) -> Answer:
        """Return the answer to a tick; without one, it is marked as not to be sent."""
        moved = self._carry("joints", joints, _turned) or _NO_JOINTS
        given: Any = [self._carry(f"force {i}", f, _wrong_force) for i, f in enumerate(forces)]
        measured: Any = None if any(each is None for each in given) else np.array(given)
        touch = self._carry("contacts", contacts, _moved)
        return super().answer(stamp, moved, touch, measured)


class FaultyLoop(GuardedLoop):
    """A closed loop with failing wires and a guard for the joints."""

    def __init__(self, chosen: Scenario, run: Injection) -> None:
        """Build the loop of a scenario for a run."""
        super().__init__(chosen, chosen.plant.guard)
        self.tick_time = 1e-9 * chosen.plant.tick
        self.wires = Wires(run, self.tick_time)
        self.chain = FaultyChain(self.loop.chain, self.wires, chosen)
        self.chain.plugged.before_step = self._command
        self.loop.chain = self.chain
        self._run, self._chance = run, random.Random(run.seed)
        self._sent: deque[tuple[int, TorqueCommand]] = deque()
        self._pause, self._late = 0.0, 0

    def tick(self, *, answers: bool = True, delay: int = 0) -> None:
        """Advance by one tick under the fault of the run."""
        del answers, delay
        loop = self.loop
        self.wires.begin_tick()
        self.chain.plugged.drives = True
        if not self._is_stopped():
            answer = loop.answer(self._row, 0)
            torque = None if answer.do_not_send else answer.torque
            torque = self.wires.carry("torque", torque, np.negative)
            if torque is not None:
                due = loop.stamp + (self.wires.delay + self._late) * loop.scenario.plant.tick
                self._sent.append((due, TorqueCommand(loop.stamp, torque)))
        while self._sent and self._sent[0][0] <= loop.stamp:
            self._newest = self._sent.popleft()[1]
        self.chain.plugged.block.joints_held = self.guard.holding
        self.act()

    def _is_stopped(self) -> bool:
        """Return whether all blocks are stopped by a fault of the computer."""
        if not self.wires.failing or self._run.component != space.COMPUTER:
            self._late = 0
            return False
        if self._run.fault == "starved":  # bursts of late answers between pauses
            self._pause -= self.tick_time
            if self._pause < -0.02:
                self._pause = self._chance.expovariate(1.0 / 0.03)
            self._late = self._chance.choice((0, 0, 1, 2, 4))
            return self._pause > 0.0
        return True

    def _command(self) -> None:
        """Send the user commands of the fault; rejections are expected."""
        cell, loop = self._run, self.loop
        if not self.wires.failing or cell.component != space.USER or cell.fault == "garbage":
            return
        here = loop.state.position.copy()
        if cell.fault == "wrong":
            here += 10.0
        elif cell.fault == "intermittent":
            here += [self._chance.uniform(-_JUMP, _JUMP) for _ in range(3)]
        with suppress(TactileHandError):
            loop.controller.targets.command(Target(here, np.eye(3)))

    def restart(self) -> None:
        """Restart a killed block."""
        cell, loop = self._run, self.loop
        if cell.fault != "off":
            return
        if cell.component == space.CONTROLLER:
            self.chain.plugged.block = Controller(loop.scenario.manipulation_controller)
        elif cell.component == space.REGULATOR:
            regulator: Any = self.chain.regulator
            regulator.block = SlipRegulator(loop.scenario.slip_regulator)
        self.chain.pass_back()


def _turned(joints: Joints) -> Joints:
    theta, rates, applied = joints
    return Joints(theta + _TURN, rates, None if applied is None else -applied)


def _moved(contacts: Contacts) -> Contacts:
    return Contacts(contacts.positions + np.array([_AWAY, 0.0, 0.0]), contacts.rotations)


def _swapped(shape: Array | None) -> Array | None:
    return None if shape is None else shape[:, [1, 0, 2]]


def _wrong_force(force: Array) -> Array:
    return np.asarray(force * np.array([-_FACTOR, _FACTOR, -_FACTOR]))


def run_in_process(run: Injection) -> Outcome:
    """Inject one fault and return the outcome."""
    faulty = FaultyLoop(scenario(run.situation, run.way), run)
    moment = SITUATIONS[run.situation].time + run.delay
    loop, seen = faulty.loop, _Seen(faulty)
    is_lost = False
    try:
        for _ in range(round(moment / faulty.tick_time)):
            faulty.tick()
        faulty.wires.failing = run.fault != space.NONE
        seen.run(FAULT_TIME)
        faulty.wires.failing = False
        faulty.restart()
        seen.run(_AFTER)
    except DivergedError:
        is_lost = True
    failing = round(max(FAULT_TIME, seen.held_until) / faulty.tick_time)
    moved = distance(run, np.array(seen.positions[:failing]), moment)
    return Outcome(
        dropped=is_lost or not bool(loop.state.contacts.all_touching) or moved > LET_GO,
        moved=moved,
        safe=seen.safe,
        peak=seen.peak,
        limit=loop.scenario.slip_regulator.maximum,
        recovered=seen.recovered,
        declared=seen.declared,
    )


class _Seen:
    """Effects on the object from the fault onward."""

    def __init__(self, faulty: FaultyLoop) -> None:
        self._faulty = faulty
        self.positions: list[Array] = []
        self.peak = self.held_until = self._time = 0.0
        self.safe: float | None = None
        self.declared = ""

    @property
    def recovered(self) -> float | None:
        """Time from the end of the fault until the hand drives [s]; None if it does not."""
        is_driving = self._faulty.chain.plugged.drives and not self._faulty.guard.holding
        return max(0.0, self.held_until - FAULT_TIME) if is_driving else None

    def run(self, seconds: float) -> None:
        """Continue and observe every tick."""
        faulty = self._faulty
        for _ in range(round(seconds / faulty.tick_time)):
            faulty.tick()
            self._time += faulty.tick_time
            state, guard = faulty.loop.state, faulty.guard
            self.positions.append(state.position.copy())
            self.peak = max(self.peak, float(state.forces[:, 1].sum()))
            if guard.holding or not faulty.chain.plugged.drives:
                self.held_until = self._time
                if guard.holding and self.safe is None:
                    self.safe, self.declared = self._time, guard.reason
