# SPDX-License-Identifier: Apache-2.0
"""Whether contacts slip, from the micro-vibration that sliding leaves in their forces."""

from __future__ import annotations

import enum
import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param

Array = NDArray[np.float64]


_GAIN = 6.0  # of white noise through a second difference: 1 + 4 + 1
_LEAK = 0.03  # share of a change of the squeeze that may show across it
_NORMAL = np.array([0.0, 1.0, 0.0])


class SlipDetectorConfig(Config):
    """Parameters of the slip detector."""

    noise: float = param(
        0.02, "expected noise of a force until it is learned", unit="N", live=True, gt=0.0
    )
    least_noise: float = param(
        0.002, "vibration below this is never taken for slip", unit="N", live=True, gt=0.0
    )
    relative_noise: float = param(0.002, "the same, per normal force", live=True, ge=0.0)
    patience: float = param(
        0.3,
        "what looks like slip for longer than this is learned as noise",
        unit="s",
        live=True,
        gt=0.0,
    )
    ratio: float = param(
        9.0, "power of the vibration against noise that the test is made for", live=True, gt=1.0
    )
    threshold: float = param(
        20.0, "evidence for slip; false alarms become rarer as its exponential", live=True, gt=0.0
    )
    learning_time: float = param(
        1.0, "time constant with which the noise is learned", unit="s", live=True, gt=0.0
    )
    settling_time: float = param(
        0.05, "after touching, nothing is said about slip for so long", unit="s", live=True, ge=0.0
    )
    least_force: float = param(
        0.05, "normal force below which nothing is said", unit="N", live=True, gt=0.0
    )


class Grip(enum.IntEnum):
    """What is known of a contact; unknown is not the same as no slip."""

    UNKNOWN = 0
    STICK = 1
    SLIP = 2


class SlipDetector:
    """Watches the power of fast force changes with Page's cumulative sum test.

    While a contact sticks, the second difference r of its force is noise of variance s^2, since
    loads change slowly against the sampling. Sliding adds vibration. The hand's own changes of the
    squeeze act along one known direction; only the two others are looked at. The test sums the
    log-likelihood ratio of variance rho s^2 against s^2, per axis

        L = ((1 - 1/rho) r^2 / s^2 - ln rho) / 2,

    starts again from zero whenever the sum is negative, and tells slip above a threshold h. While a
    contact sticks the time between false alarms grows as exp(h). A single sample never counts for
    more than h / 4: a push on the object shows in one sample, sliding in many.

    Source: Page, Continuous inspection schemes, 1954.
    """

    def __init__(self, config: SlipDetectorConfig, fingers: int) -> None:
        """Watch a number of contacts."""
        self._k = fingers
        self.config = config
        self.reset()

    def configure(self, config: SlipDetectorConfig) -> None:
        """Take other parameters; what was learned stays."""
        self.config = config

    def reset(self) -> None:
        """Forget everything."""
        k = self._k
        self.evidence = np.zeros(k)
        self.state = np.full(k, Grip.UNKNOWN)
        self._variance = np.full(k, _GAIN * self.config.noise**2)
        self._last = np.full((k, 3), np.nan)
        self._change = np.full((k, 3), np.nan)
        self._touched_for = np.zeros(k)
        self._slipped_for = np.zeros(k)

    @property
    def likelihood(self) -> Array:
        """Evidence for slip against its threshold, 0 to 1, shape (k,)."""
        return np.minimum(self.evidence / self.config.threshold, 1.0)

    def step(
        self, forces: Array, dt: float, squeeze: Array | None = None, own_change: float = 0.0
    ) -> NDArray[np.int_]:
        """Take the forces of a tick and return a `Grip` for each contact, shape (k,).

        Args:
            forces: Measured forces in contact frames, shape (k, 3), N; NaN where unknown.
            dt: Time since the last tick, s.
            squeeze: Part of the forces that the hand's squeeze makes, shape (k, 3), N; the normal
                forces by default.
            own_change: How much the hand itself has just bent its squeeze, N; some of that shows
                across the squeeze too.
        """
        c = self.config
        change, before = forces - self._last, self._change
        self._last, self._change = forces.copy(), change
        bend = across(change - before, forces * _NORMAL if squeeze is None else squeeze)
        known = np.isfinite(bend[:, 0]) & (forces[:, 1] > c.least_force)
        self._touched_for = np.where(known, self._touched_for + dt, 0.0)
        power = np.where(known, (bend * bend).sum(axis=1), 0.0)
        ready = known & (self._touched_for > c.settling_time)
        # A sensor that is slower than the loop repeats its sample, which tells nothing.
        fresh = ready & (power > 0.0)
        least = c.least_noise**2 + np.where(known, c.relative_noise * forces[:, 1], 0.0) ** 2
        floor = np.maximum(self._variance, _GAIN * least)
        self._collect(power / (floor + (_LEAK * own_change) ** 2), fresh)
        self.evidence[~ready] = 0.0
        slipping = np.where(
            self.state == Grip.SLIP,
            self.evidence > 0.75 * c.threshold,
            self.evidence > c.threshold,
        )
        self._slipped_for = np.where(slipping, self._slipped_for + dt, 0.0)
        plain = ~slipping | (self._slipped_for > c.patience)
        self._learn(power, known & plain & (power > 0.0), dt)
        self.state = np.where(ready, np.where(slipping, Grip.SLIP, Grip.STICK), Grip.UNKNOWN)
        return self.state

    def _collect(self, relative: Array, fresh: NDArray[np.bool_]) -> None:
        c = self.config
        gain = 0.5 * ((1.0 - 1.0 / c.ratio) * relative - 2.0 * math.log(c.ratio))
        total = np.maximum(self.evidence + np.minimum(gain, 0.25 * c.threshold), 0.0)
        self.evidence = np.where(fresh, np.minimum(total, 1.2 * c.threshold), self.evidence)

    def _learn(self, power: Array, sticking: NDArray[np.bool_], dt: float) -> None:
        """Follow the noise, quickly after touching; a push counts for no more than its noise."""
        c = self.config
        time = np.minimum(c.learning_time, np.maximum(self._touched_for, 1e-9))
        share = np.where(sticking, np.minimum(dt / np.maximum(time, 10.0 * dt + 1e-12), 1.0), 0.0)
        bounded = np.minimum(power / 2.0, 3.0 * self._variance)
        self._variance = self._variance + share * (bounded - self._variance)


def across(vectors: Array, axes: Array) -> Array:
    """Return vectors without their parts along axes of any length, both of shape (k, 3)."""
    length = (axes * axes).sum(axis=1, keepdims=True)
    along = (vectors * axes).sum(axis=1, keepdims=True) / np.maximum(length, 1e-300)
    return np.asarray(vectors - along * axes)
