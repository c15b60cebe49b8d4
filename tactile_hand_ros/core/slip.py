# SPDX-License-Identifier: Apache-2.0
"""The squeeze k_f: what the user asks for, inside limits and without jumps."""

from __future__ import annotations

import math

from pydantic import model_validator

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.errors import MessageError


class SlipRegulatorConfig(Config):
    """Parameters of the slip-prevention regulator."""

    hand: str = param("paper", "hand by name or YAML file")
    grasp_force: float = param(
        10.0, "squeeze k_f until the user asks for another", unit="N", gt=0.0
    )
    minimum: float = param(0.5, "least squeeze", unit="N", live=True, ge=0.0)
    maximum: float = param(40.0, "largest squeeze, the crush limit", unit="N", live=True, gt=0.0)
    rise_rate: float = param(50.0, "fastest rise of the squeeze", unit="N/s", live=True, gt=0.0)
    fall_rate: float = param(20.0, "fastest fall of the squeeze", unit="N/s", live=True, gt=0.0)
    smoothing: float = param(
        0.05, "time constant with which the squeeze lands on its goal", unit="s", live=True, gt=0.0
    )

    @model_validator(mode="after")
    def _limits_are_ordered(self) -> SlipRegulatorConfig:
        if not self.minimum <= self.grasp_force <= self.maximum:
            raise ValueError(
                f"grasp_force = {self.grasp_force} N is outside minimum = {self.minimum} N to "
                f"maximum = {self.maximum} N"
            )
        return self


class SlipRegulator:
    """Moves k_f smoothly to what the user asks for.

    Far from its goal the squeeze moves at the rise or fall rate, near it it lands exponentially.
    """

    def __init__(self, config: SlipRegulatorConfig) -> None:
        """Start at the configured squeeze."""
        self.config = config
        self.reset()

    def configure(self, config: SlipRegulatorConfig) -> None:
        """Take other limits and rates; the squeeze moves inside new limits at the allowed rate."""
        self.config = config

    def reset(self) -> None:
        """Go back to the configured squeeze."""
        self.grasp_force = self._goal = self.config.grasp_force
        self._last_stamp: int | None = None

    def request(self, grasp_force: float) -> None:
        """Take the squeeze that the user asks for, in N.

        Raises:
            MessageError: If it is outside the limits or not a number.
        """
        c = self.config
        if not math.isfinite(grasp_force) or not c.minimum <= grasp_force <= c.maximum:
            raise MessageError(
                f"requested grasp force {grasp_force} N is outside {c.minimum} to {c.maximum} N; "
                "ask for one inside or change the limits 'minimum' and 'maximum'"
            )
        self._goal = grasp_force

    def step(self, stamp: int) -> float:
        """Return k_f in N at a tick in ns; a tick that was seen before changes nothing."""
        c = self.config
        dt = 0.0 if self._last_stamp is None else max(0.0, 1e-9 * (stamp - self._last_stamp))
        self._last_stamp = stamp
        goal = min(max(self._goal, c.minimum), c.maximum)
        rate = min(max((goal - self.grasp_force) / c.smoothing, -c.fall_rate), c.rise_rate)
        step = rate * dt
        overshoots = abs(step) >= abs(goal - self.grasp_force)
        self.grasp_force = goal if overshoots else self.grasp_force + step
        return self.grasp_force
