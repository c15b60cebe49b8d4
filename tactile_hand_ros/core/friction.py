# SPDX-License-Identifier: Apache-2.0
"""The friction of each contact, learned from its slips and sticks only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.slip_detector import Grip

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAMPLES = 4  # that are averaged against noise and vibration


class FrictionConfig(Config):
    """Parameters of the friction estimate."""

    prior: float = param(0.4, "friction assumed before anything is known", live=True, gt=0.0)
    least: float = param(0.1, "friction is never taken for lower", live=True, gt=0.0)
    most: float = param(1.5, "friction is never taken for higher", live=True, gt=0.0)
    explore: float = param(
        0.03,
        "growth of an estimate that no slip has bounded yet, so that the squeeze is lowered until "
        "something slips a little",
        unit="1/s",
        live=True,
        ge=0.0,
    )
    forget: float = param(
        0.002, "growth of an estimate that a slip has bounded", unit="1/s", live=True, ge=0.0
    )
    smoothing: float = param(0.01, "time constant of the force ratio", unit="s", live=True, gt=0.0)
    window: float = param(
        0.03, "how long the force ratio before a detection is remembered", unit="s", gt=0.0
    )


class FrictionEstimator:
    """Bounds mu per contact: sticking at a force ratio proves mu above it, slipping shows mu.

    Attributes:
        estimate: mu of each contact, shape (k,).
        learned: Whether a slip has shown it, shape (k,).
    """

    def __init__(self, config: FrictionConfig, fingers: int) -> None:
        """Start from the prior."""
        self._k = fingers
        self.config = config
        self.reset()

    def configure(self, config: FrictionConfig) -> None:
        """Take other parameters; what was learned stays."""
        self.config = config

    def reset(self) -> None:
        """Forget what was learned."""
        self.estimate = np.full(self._k, self.config.prior)
        self.learned = np.zeros(self._k, dtype=bool)
        self._ratio = np.zeros(self._k)
        self._slid = np.zeros(self._k, dtype=bool)
        self._recent = np.zeros((_SAMPLES, self._k, 3))
        self._peak = np.zeros(self._k)

    def step(self, forces: Array, state: NDArray[np.int_], dt: float) -> Array:
        """Return the estimates after a tick, shape (k,).

        Args:
            forces: Measured forces in contact frames, shape (k, 3), N.
            state: `Grip` of each contact, shape (k,).
            dt: Time since the last tick, s.
        """
        c = self.config
        known = state != Grip.UNKNOWN
        normal = np.where(known, forces[:, 1], 1.0)
        ratio = np.where(known, np.hypot(forces[:, 0], forces[:, 2]) / normal, 0.0)
        share = min(1.0, dt / c.smoothing)
        self._ratio = np.where(known, self._ratio + share * (ratio - self._ratio), 0.0)
        self._from_sticks(state == Grip.STICK, dt)
        self._from_slips(state == Grip.SLIP, np.where(known[:, None], forces, 0.0), dt)
        self.estimate = np.clip(self.estimate, c.least, c.most)
        return self.estimate

    def _from_sticks(self, sticks: Mask, dt: float) -> None:
        c = self.config
        growth = 1.0 + dt * np.where(self.learned, c.forget, c.explore)
        grown = np.where(sticks, self.estimate * growth, self.estimate)
        self.estimate = np.where(sticks, np.maximum(grown, self._ratio), grown)

    def _from_slips(self, slips: Mask, forces: Array, dt: float) -> None:
        """Take the largest force ratio around the detection of a slip.

        A contact that slides shows mu; one that sticks, before or since, shows less. Detection
        needs some samples, in which the squeeze may already have caught the object.
        """
        recent = np.concatenate([self._recent[1:], forces[None]])
        self._recent = recent
        mean = recent.sum(axis=0)
        normal = np.where(mean[:, 1] > 0.0, mean[:, 1], np.inf)
        ratio = np.hypot(mean[:, 0], mean[:, 2]) / normal
        fading = 1.0 - min(1.0, dt / self.config.window)
        # The peak fades within the window, so that it tells of the last moments only.
        self._peak = np.maximum(np.where(np.isfinite(ratio), ratio, 0.0), fading * self._peak)
        began = slips & ~self._slid
        self._slid = slips
        self.estimate = np.where(began, self._peak, self.estimate)
        self.estimate = np.where(slips, np.maximum(self.estimate, ratio), self.estimate)
        self.learned = self.learned | slips
