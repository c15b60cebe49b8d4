# SPDX-License-Identifier: Apache-2.0
"""The squeeze that a touched object needs, from a load that is foreseen and a shape that is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.squeeze import Split, required_squeeze

Array = NDArray[np.float64]


class NeedConfig(Config):
    """How load and shape of a grasp are followed."""

    smoothing: float = param(
        0.005, "time constant of the measured load", unit="s", live=True, gt=0.0
    )
    shape_smoothing: float = param(
        0.03,
        "time constant of how the fingers share the squeeze; only the hand itself changes that",
        unit="s",
        live=True,
        gt=0.0,
    )
    least_trend: float = param(
        5.0, "rate of a load below which it is noise", unit="N/s", live=True, ge=0.0
    )
    lead: float = param(
        0.01, "how far ahead a changing load is foreseen", unit="s", live=True, ge=0.0
    )


class Need:
    """Follows load and shape of the squeeze, and computes the least squeeze that holds.

    The load may change at any time and is followed fast. The shape is f*, which the hand itself
    changes slowly: a finger that presses with a few tenths of a newton shows it only through noise,
    and the need of a shape near the edge of its cone grows without bound.
    """

    def __init__(self) -> None:
        """Start without a grasp."""
        self.reset()

    def reset(self) -> None:
        """Forget load and shape."""
        self._load: Array | None = None

    def step(self, parts: Split, friction: Array, config: NeedConfig, dt: float) -> float:
        """Return the least squeeze that keeps every contact inside its cone, N.

        Args:
            parts: Measured forces as load and squeeze; the squeeze must push.
            friction: mu to hold with at each contact, shape (k,).
            config: Parameters.
            dt: Time since the last tick, s.

        Returns:
            Infinite when no squeeze of the present shape can hold.
        """
        load = self._follow(parts, config, dt)
        pairs = zip(load, self._shape, friction.tolist(), strict=True)
        return max(required_squeeze(own, shape, mu) for own, shape, mu in pairs)

    def _follow(self, parts: Split, c: NeedConfig, dt: float) -> Array:
        """Smooth load and shape; return the load, extrapolated by the lead time."""
        shape = parts.squeeze / parts.grasp_force
        if self._load is None or dt == 0.0:
            self._load, self._shape, self._trend = parts.load, shape, np.zeros_like(parts.load)
            return self._load
        self._shape = self._shape + min(1.0, dt / c.shape_smoothing) * (shape - self._shape)
        share = min(1.0, dt / c.smoothing)
        before = self._load
        self._load = before + share * (parts.load - before)
        # The smoothed load lags by its time constant; the trend makes up for it and looks ahead.
        self._trend = self._trend + share * ((self._load - before) / dt - self._trend)
        speed = np.sqrt((self._trend * self._trend).sum(axis=1, keepdims=True))
        real = np.maximum(0.0, 1.0 - c.least_trend / np.maximum(speed, 1e-12))
        return np.asarray(self._load + (c.smoothing + c.lead) * real * self._trend)
