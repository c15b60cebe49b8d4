# SPDX-License-Identifier: Apache-2.0
"""What any controller could still hold: a hand that is told all, but no earlier than its skin.

A grasp may be able to carry a load that no hand can meet in time: until the first sample of the
event has come through the skin nothing can be known, and then the squeeze can only rise so fast.
Here a hand squeezes as in the run until that sample is there. From then on it knows friction, feels
without noise and delay, and raises the squeeze at the reflex's rate to the crush limit. What it
loses too is taken for lost to every hand with that skin and that rate. That is evidence, not proof:
it keeps to the law (14) and to the squeeze that the run began with.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from studies.slip.cases import EVENT_TIME, SlipCase, scenario_of
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.scenario.scenario import Scenario

Array = NDArray[np.float64]

PERFECT = {
    "tactile_sensor__force_noise": 0.0,
    "tactile_sensor__latency": 0.0,
    "tactile_sensor__rate": 1000.0,
}
"""A skin that hides nothing, as changes of a case's scenario."""


def first_told(case: SlipCase) -> float:
    """Return when the first sample that holds anything of the event reaches the hand, s."""
    sample = (math.floor(EVENT_TIME * case.rate + 1e-6) + 1) / case.rate
    return 1e-3 * math.ceil(1e3 * (sample + case.latency) - 1e-6)


class Foresight(SlipRegulator):
    """Squeezes as at the start until it is told, and then as hard as it may."""

    def __init__(self, config: SlipRegulatorConfig, fingers: int, told: float, mu: float) -> None:
        """Know the friction mu from a time in s on."""
        super().__init__(config, fingers)
        self._told, self._mu = round(1e9 * told), mu

    @property
    def learned_friction(self) -> Array:
        """Friction of each contact, shape (k,)."""
        known = self._last_stamp is not None and self._last_stamp >= self._told
        mu = self._mu if known else self.config.friction.prior
        return np.full_like(super().learned_friction, mu)

    def step(
        self, stamp: int, contacts: Contacts | None = None, forces: Array | None = None
    ) -> float:
        """Return k_f in N at a tick."""
        if self._last_stamp is not None and stamp >= self._told:
            rise = 1e-9 * (stamp - self._last_stamp) * self.config.reflex.rise_rate
            self.grasp_force = min(self.grasp_force + rise, self.config.maximum)
        self._last_stamp = stamp
        return self.grasp_force


def foresee(case: SlipCase) -> tuple[Record, Scenario]:
    """Run a case with a hand that is told all when its skin could tell."""
    scenario = scenario_of(case, **PERFECT)
    loop = ClosedLoop(scenario)
    mu = case.friction / (case.load if case.event == "friction" else 1.0)
    config = scenario.slip_regulator
    loop.chain.regulator = Foresight(config, loop.plant.hand.fingers, first_told(case), mu)
    return loop.run(), scenario
