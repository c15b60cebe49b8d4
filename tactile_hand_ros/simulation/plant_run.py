# SPDX-License-Identifier: Apache-2.0
"""A run of the plant: ticks, their stamps, the end, and the guard in front of the joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.command_guard import CommandGuard, TorqueCommand
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import PlantConfig

Array = NDArray[np.float64]


class PlantRun:
    """Moves a plant tick by tick; the joints get only what the guard lets through.

    Attributes:
        plant: The plant.
        guard: Judges each command at each tick.
        state: Hand and object at the present tick.
        stamp: The present tick, ns.
    """

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object at their start.

        Raises:
            TactileHandError: If hand or object cannot be built.
        """
        self.plant = Plant(config)
        self.guard = CommandGuard(config.guard, self.plant.model, config.tick, config.step)
        self._tick = config.tick
        self._end = round(config.duration * config.rate) * config.tick
        self._load_compiled_code()
        self.reset()

    def _load_compiled_code(self) -> None:
        """Step once, so that neither the first tick nor the first held one is late."""
        self.plant.drive(lambda since, theta, rates: self.guard.step(since, theta, rates, None))

    def reset(self) -> None:
        """Go back to the start, at stamp 0 and without torque."""
        self.state = self.plant.reset()
        self.guard.reset()
        self.stamp = 0
        self._command: TorqueCommand | None = None
        self._refused = ""

    def configure(self, config: PlantConfig) -> None:
        """Take another friction, for now and for after a reset."""
        self.plant.config = config
        self.plant.friction[:] = config.object.friction

    @property
    def is_last(self) -> bool:
        """Whether the present tick is the last one; never without a duration."""
        return 0 < self._end <= self.stamp

    @property
    def commanded(self) -> bool:
        """Whether a torque was commanded since the start."""
        return self._command is not None

    @property
    def refusing(self) -> bool:
        """Whether all commands are refused."""
        return bool(self._refused)

    @property
    def reason(self) -> str:
        """Why the joints are held; empty while they are not."""
        return self._refused or self.guard.reason

    def command(self, stamp: int, torque: Array) -> None:
        """Take the torque, shape (m,), N m, that answers a tick, ns; the guard judges it."""
        self._command = TorqueCommand(stamp, torque)

    def hold(self, reason: str) -> None:
        """Refuse all commands from now on, so that the joints are held."""
        self._refused = reason

    def release(self) -> None:
        """Let good commands act again."""
        self._refused = ""

    def advance(self) -> None:
        """Move one tick ahead."""
        command, refused, stamp = self._command, self._refused, self.stamp

        def guarded(since: int, theta: Array, rates: Array) -> Array:
            return self.guard.step(stamp + since, theta, rates, command, refused)

        self.state = self.plant.drive(guarded)
        self.stamp += self._tick
