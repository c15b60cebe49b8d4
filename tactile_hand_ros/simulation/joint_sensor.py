# SPDX-License-Identifier: Apache-2.0
"""The simulated encoders and current sensors of the joints."""

from __future__ import annotations

import math

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.hand.joints import Joints


class EncoderConfig(Config):
    """Errors of joint angles; exact without bits and noise."""

    bits: int = param(0, "resolution of a turn, 0 for exact", ge=0, le=32)
    noise: float = param(0.0, "standard deviation of an angle", unit="rad", ge=0.0)
    rate_cutoff: float = param(100.0, "corner frequency of the rates", unit="Hz", gt=0.0)

    @property
    def step(self) -> float:
        """Step of an angle, rad; 0 for a continuous one."""
        return 2.0 * math.pi / 2**self.bits if self.bits else 0.0

    @property
    def resolution(self) -> float:
        """Error of an angle, rad: a step, and three standard deviations; 0 if it is exact."""
        return self.step + 3.0 * self.noise


class JointSensor:
    """Reports joint angles in steps of an encoder, and rates as filtered differences of them.

    An encoder of b bits reports the middle of one of 2^b steps per turn. Its rates are low-passed
    differences of these angles, r += (1 - exp(-2 pi f T)) (d theta / T - r), with the corner
    frequency f. An exact encoder reports the true rates.
    """

    def __init__(self, encoder: EncoderConfig, effort_noise: float, tick: float, seed: int) -> None:
        """Build the sensors, with the noise of a torque in N m, and s between two readings."""
        self._encoder, self._effort_noise, self._tick = encoder, effort_noise, tick
        self._follow = -math.expm1(-2.0 * math.pi * encoder.rate_cutoff * tick)
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Start with joints at rest and the first noise again."""
        # A separate stream: the skin uses [seed] and [seed, 1].
        self._random = np.random.default_rng([self._seed, 2])
        self._last: Array | None = None
        self._rates = np.zeros(0)

    def step(self, theta: Array, rates: Array, effort: Array) -> Joints:
        """Return the report of true angles, rad, rates, rad/s, and torques, N m, shapes (m,)."""
        if self._effort_noise > 0.0:
            effort = effort + self._random.normal(0.0, self._effort_noise, len(effort))
        if self._encoder.resolution == 0.0:
            return Joints(theta, rates, effort)
        seen = theta
        if self._encoder.noise > 0.0:
            seen = seen + self._random.normal(0.0, self._encoder.noise, len(theta))
        if self._encoder.bits:
            seen = (np.floor(seen / self._encoder.step) + 0.5) * self._encoder.step
        if self._last is None:
            self._last, self._rates = seen, np.zeros(len(theta))
        differences = (seen - self._last) / self._tick
        self._rates = self._rates + self._follow * (differences - self._rates)
        self._last = seen
        return Joints(seen, self._rates, effort)
