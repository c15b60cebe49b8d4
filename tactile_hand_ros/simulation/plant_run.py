# SPDX-License-Identifier: Apache-2.0
"""A run of the plant: ticks, stamps, duration, and the guard in front of the joints."""

from __future__ import annotations

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.command_guard import CommandGuard, TorqueCommand
from tactile_hand_ros.simulation.mujoco_plant import make_plant
from tactile_hand_ros.simulation.plant_config import PlantConfig

PUSH_LASTS = 200_000_000
"""Time after which a push ends that is not renewed, so that no dead user pulls on, ns."""


class PlantRun:
    """Moves a plant tick by tick, with a guard in front of the joints.

    Attributes:
        plant: The plant.
        guard: Checks the command at each tick.
        state: Hand and object at the present tick.
        stamp: The present tick, ns.
        refused: Why all commands are refused, so that the joints are held; empty to let them act.
    """

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object in their initial state.

        Raises:
            TactileHandError: If hand or object cannot be built.
        """
        self.plant = make_plant(config)
        self.guard = CommandGuard(config.guard, self.plant.model, config.tick, config.step)
        self._tick = config.tick
        self._end = round(config.duration * config.rate) * config.tick
        # One step loads the compiled code, so that the first ticks are not late.
        self.plant.drive(lambda since, theta, rates: self.guard.step(since, theta, rates, None))
        self.reset()

    def reset(self) -> None:
        """Go back to the start, at stamp 0 and without torque."""
        self.state = self.plant.reset()
        self.guard.reset()
        self.stamp = 0
        self._command: TorqueCommand | None = None
        self.refused = ""

    @property
    def is_last(self) -> bool:
        """Whether the present tick is the last one; never without a duration."""
        return 0 < self._end <= self.stamp

    @property
    def commanded(self) -> bool:
        """Whether a command has arrived since the start."""
        return self._command is not None

    @property
    def reason(self) -> str:
        """Why the joints are held; empty while they are not."""
        return self.refused or self.guard.reason

    def command(self, stamp: int, torque: Array) -> None:
        """Receive the torque, shape (m,), N m, that answers a tick, ns; the guard checks it."""
        self._command = TorqueCommand(stamp, torque)

    def push(self, stamp: int, wrench: Array) -> None:
        """Push the object for `PUSH_LASTS` from a stamp, ns, on; from now on if that is 0 or later.

        The wrench acts at the center of mass, palm axes, shape (6,), N and N m.
        """
        since = min(stamp or self.stamp, self.stamp)
        self.plant.push(wrench, 1e-9 * (since + PUSH_LASTS))

    def advance(self) -> None:
        """Move one tick ahead."""
        command, refused, stamp = self._command, self.refused, self.stamp

        def guarded(since: int, theta: Array, rates: Array) -> Array:
            return self.guard.step(stamp + since, theta, rates, command, refused)

        self.state = self.plant.drive(guarded)
        self.stamp += self._tick
