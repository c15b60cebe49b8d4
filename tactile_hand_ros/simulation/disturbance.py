# SPDX-License-Identifier: Apache-2.0
"""External wrenches w_e on the object over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param

Vector = tuple[float, float, float]


class Disturbance(Config):
    """One push on the object, at its centre of mass and in palm axes."""

    kind: Literal["step", "ramp", "pulse", "sine"] = param(
        "step",
        "step stays, ramp rises for its duration and stays, pulse ends after its duration, sine "
        "swings for its duration",
    )
    start: float = param(0.0, "when it begins", unit="s", ge=0.0)
    duration: float = param(0.1, "how long a ramp, pulse or sine lasts", unit="s", gt=0.0)
    frequency: float = param(1.0, "frequency of a sine", unit="Hz", gt=0.0)
    force: Vector = param((0.0, 0.0, 0.0), "force, the amplitude of a sine", unit="N")
    torque: Vector = param((0.0, 0.0, 0.0), "torque, the amplitude of a sine", unit="N m")

    def factor(self, time: float) -> float:
        """Return the share of force and torque that acts at a time in s."""
        since = time - self.start
        if since < 0.0 or (self.kind in ("pulse", "sine") and since >= self.duration):
            return 0.0
        if self.kind == "ramp":
            return min(1.0, since / self.duration)
        return float(np.sin(2.0 * np.pi * self.frequency * since)) if self.kind == "sine" else 1.0


def external_wrench(disturbances: Sequence[Disturbance], time: float) -> NDArray[np.float64]:
    """Return w_e, force and torque about the object's centre of mass, shape (6,), N and N m."""
    wrench = np.zeros(6)
    for push in disturbances:
        factor = push.factor(time)
        if factor != 0.0:
            wrench += factor * np.array((*push.force, *push.torque))
    return wrench
