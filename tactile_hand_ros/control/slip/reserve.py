# SPDX-License-Identifier: Apache-2.0
"""The reserve: forces that a grasp is ready for although nothing shows them yet.

A load that comes at once acts before a hand can answer it. The grasp is therefore made for every
load within a radius delta of the present one, at each contact:

    delta = max(floor / k, share of the largest load of the recent past).

A force stays in its cone, whatever comes within delta, where

    mu f_n - |f_t| >= delta sqrt(1 + mu^2):

the cone is moved along its normal by delta sqrt(1 + 1 / mu^2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.jit.compiled import compiled

Array = NDArray[np.float64]


class ReserveConfig(Config):
    """How much more than it feels a grasp is ready for."""

    floor: float = param(
        3.0, "force on the object that may come at any time", unit="N", live=True, ge=0.0
    )
    share: float = param(
        0.2, "share of the largest recent load that may come on top", live=True, ge=0.0, le=2.0
    )
    memory: float = param(
        5.0, "time constant with which recent loads are forgotten", unit="s", live=True, gt=0.0
    )


class Reserve:
    """Remembers the largest load of the recent past at each contact."""

    def __init__(self, config: ReserveConfig, contacts: int) -> None:
        """Start without a past of k contacts."""
        self._largest = np.zeros(contacts)
        self.configure(config)

    def configure(self, config: ReserveConfig) -> None:
        """Take other parameters; the past stays."""
        self._floor = config.floor
        self._share = config.share
        self._memory = config.memory

    def reset(self) -> None:
        """Forget the past."""
        self._largest[:] = 0.0

    def step(self, load: Array, dt: float) -> Array:
        """Return the radius delta of each contact, shape (k,), N.

        Args:
            load: What the contacts carry, shape (k, 3), N.
            dt: Time since the last tick, s.
        """
        return _radii(self._largest, load, dt, self._floor, self._share, self._memory)


@compiled
def _radii(
    largest: Array, load: Array, dt: float, floor: float, share: float, memory: float
) -> Array:
    keep, radii = math.exp(-dt / memory), np.empty(len(largest))
    for i in range(len(largest)):
        x, n, z = load[i]
        largest[i] = max(keep * largest[i], math.sqrt(x * x + n * n + z * z))
        radii[i] = max(floor / len(largest), share * largest[i])
    return radii


@compiled
def shift(radius: float, friction: float) -> float:
    """Return by how much a cone is moved along its normal for a radius of loads, in N."""
    return radius * math.sqrt(1.0 + 1.0 / (friction * friction))
