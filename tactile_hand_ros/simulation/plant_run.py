# SPDX-License-Identifier: Apache-2.0
"""A run of the plant: ticks, their stamps, the end, and the safe hold when nobody commands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.safe_hold import HoldConfig, SafeHold
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import PlantConfig

Array = NDArray[np.float64]


class PlantRun:
    """Moves a plant tick by tick and keeps the joints safe between commands.

    Attributes:
        plant: The plant.
        state: Hand and object at the present tick.
        stamp: The present tick, ns.
        commanded: Whether a torque was commanded since the start.
        held: How many ticks were run in safe hold.
    """

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object at their start.

        Raises:
            TactileHandError: If hand or object cannot be built.
        """
        self.plant = Plant(config)
        self._hold = SafeHold(HoldConfig())
        self._tick = config.tick
        self._end = round(config.duration * config.rate) * config.tick
        self.held = 0
        # The first step of a process loads compiled code; that shall not make the first tick late.
        self.plant.advance(np.zeros(self.plant.hand.joints))
        self.reset()

    def reset(self) -> None:
        """Go back to the start, at stamp 0 and without torque."""
        self.state = self.plant.reset()
        self.stamp = 0
        self.commanded = False
        self._torque = np.zeros(self.plant.hand.joints)
        self._hold.release()

    def configure(self, config: PlantConfig) -> None:
        """Take another friction, for now and for after a reset."""
        self.plant.config = config
        self.plant.friction[:] = config.object.friction

    @property
    def is_last(self) -> bool:
        """Whether the present tick is the last one; never without a duration."""
        return 0 < self._end <= self.stamp

    @property
    def holding(self) -> bool:
        """Whether the joints are in safe hold."""
        return self._hold.active

    def command(self, torque: Array) -> None:
        """Take a torque, shape (m,), N m; it acts from now on and ends a safe hold."""
        self._hold.release()
        self._torque = torque
        self.commanded = True

    def hold(self) -> None:
        """Hold the joints where they are, on top of the last torque."""
        self._hold.engage(self.state.theta, self._torque)

    def release(self) -> None:
        """End a safe hold; the last torque acts again."""
        self._hold.release()

    def advance(self) -> None:
        """Move one tick ahead."""
        torque = self._torque
        if self._hold.active:
            torque = self._hold.torque(self.state.theta, self.state.rates)
            self.held += 1
        self.state = self.plant.advance(torque)
        self.stamp += self._tick
