# SPDX-License-Identifier: Apache-2.0
"""Whether a contact slips, from the micro-vibration that sliding leaves in their forces."""

from __future__ import annotations

import enum
import math

from tactile_hand_ros.core.config import Config, param

Force = tuple[float, float, float]

_STILL = (0.0, 0.0, 0.0)
_GAIN = 6.0  # of white noise through a second difference: 1 + 4 + 1
_BOUND = 3.0  # times its noise, for which a sample counts at most while the noise is learned
_UNBIASED = 1.0 / (1.0 - math.exp(-_BOUND))  # makes up for it: power has two degrees of freedom
_BRINK = 0.95  # share of the believed friction from which on a contact may well be slipping
_LEAK = 0.03  # share of a change of the squeeze that may show across it


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
        28.0, "evidence for slip; false alarms become rarer as its exponential", live=True, gt=0.0
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
    """Watches the power of fast force changes at one contact with Page's cumulative sum test.

    While a contact sticks, the second difference r of its force is noise of variance s^2, since
    loads change slowly against the sampling. Sliding adds vibration. The hand's own changes of the
    squeeze act along one known direction; only the two others are looked at. The test sums the
    log-likelihood ratio of variance rho s^2 against s^2, per axis

        L = ((1 - 1/rho) r^2 / s^2 - ln rho) / 2,

    starts again from zero whenever the sum is negative, and tells slip above a threshold h. While a
    contact sticks the time between false alarms grows as exp(h). A single sample never counts for
    more than h / 4: a push on the object shows in one sample, sliding in many.

    Source: Page, Continuous inspection schemes, 1954.

    Attributes:
        state: What is known of the contact.
        evidence: The sum, above `threshold` a slip.
        agrees: Whether the newest sample told of slip rather than of stick.
    """

    def __init__(self, config: SlipDetectorConfig) -> None:
        """Watch one contact."""
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state = Grip.UNKNOWN
        self.evidence = 0.0
        self.agrees = False
        self._variance = _GAIN * self.config.noise**2
        self._last: Force | None = None
        self._change: Force | None = None
        self._touched_for = self._slipped_for = 0.0

    @property
    def likelihood(self) -> float:
        """Evidence for slip against its threshold, 0 to 1."""
        return min(self.evidence / self.config.threshold, 1.0)

    def step(
        self,
        force: Force | None,
        squeeze: Force,
        own_change: float,
        dt: float,
        friction: float = math.inf,
    ) -> Grip:
        """Take the force of a tick and return what is known of the contact.

        Args:
            force: Measured force in the contact frame (x, n, z), N; None where there is none.
            squeeze: Direction in which the hand's squeeze acts here, of any length.
            own_change: How much the hand itself has just bent its squeeze, N; some of that shows
                across the squeeze too.
            dt: Time since the last tick, s.
            friction: What is believed of mu. At the brink of that cone fewer samples must agree: a
                false alarm there could not lower the belief.
        """
        # A sensor that is slower than the loop repeats its sample, which tells nothing.
        new = force is None or force != self._last
        bend = self._bend(force) if new else _STILL
        if force is None or bend is None or force[1] <= self.config.least_force:
            self._touched_for = self.evidence = 0.0
            self.state = Grip.UNKNOWN
            return self.state
        self._touched_for += dt
        power = _power_across(bend, squeeze)
        if self._touched_for <= self.config.settling_time:
            if new:
                self._learn(power, dt)
            self.evidence = 0.0
            self.state = Grip.UNKNOWN
            return self.state
        if new:
            brink = math.hypot(force[0], force[2]) > _BRINK * friction * force[1]
            self._collect(power, force[1], own_change, 1.0 / 3.0 if brink else 0.25)
        self._decide(dt)
        if new and (self.state is Grip.STICK or self._slipped_for > self.config.patience):
            self._learn(power, dt)
        return self.state

    def _bend(self, force: Force | None) -> Force | None:
        """Return the second difference of the force, None until there are three samples."""
        last, before = self._last, self._change
        self._last = force
        if force is None or last is None:
            self._change = None
            return None
        change = (force[0] - last[0], force[1] - last[1], force[2] - last[2])
        self._change = change
        if before is None:
            return None
        return change[0] - before[0], change[1] - before[1], change[2] - before[2]

    def _collect(self, power: float, normal: float, own_change: float, most: float) -> None:
        c = self.config
        least = _GAIN * (c.least_noise**2 + (c.relative_noise * normal) ** 2)
        variance = max(self._variance, least) + (_LEAK * own_change) ** 2
        gain = 0.5 * ((1.0 - 1.0 / c.ratio) * power / variance - 2.0 * math.log(c.ratio))
        self.agrees = gain > 0.0
        total = max(0.0, self.evidence + min(gain, most * c.threshold))
        self.evidence = min(total, 1.2 * c.threshold)

    def _decide(self, dt: float) -> None:
        slips = self.evidence > (0.75 if self.state is Grip.SLIP else 1.0) * self.config.threshold
        self._slipped_for = self._slipped_for + dt if slips else 0.0
        self.state = Grip.SLIP if slips else Grip.STICK

    def _learn(self, power: float, dt: float) -> None:
        """Follow the noise, quickly after touching; a push counts for no more than its noise."""
        time = max(min(self.config.learning_time, self._touched_for), 10.0 * dt, 1e-9)
        bounded = min(0.5 * power, _BOUND * self._variance)
        self._variance += min(dt / time, 1.0) * (_UNBIASED * bounded - self._variance)


def _power_across(vector: Force, axis: Force) -> float:
    """Return the square of the part of a vector that is normal to an axis of any length."""
    x, y, z = vector
    a, b, c = axis
    length = a * a + b * b + c * c
    along = x * a + y * b + z * c
    return max(0.0, x * x + y * y + z * z - (along * along / length if length > 0.0 else 0.0))
