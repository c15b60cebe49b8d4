# SPDX-License-Identifier: Apache-2.0
"""The friction of a contact, learned from its slips and sticks only."""

from __future__ import annotations

import math
from collections import deque

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.slip_detector import Force, Grip

_SAMPLES = 4  # that are averaged against noise and vibration
_READINGS = 10  # of a slip that count; later the squeeze may long have caught it
_LARGEST = 3  # of them that are averaged
_EXACT = 1e-4  # variance below which no force ratio is known
_AFTERSHOCKS = 0.05  # s in which further alarms belong to the same slip
_SURE = 2.0  # standard deviations by which a force ratio must be proven
_INERTIA = 2.0  # slips that a well known friction weighs as much as
_AGREE = 0.15  # relative difference up to which two slips show the same friction


class FrictionConfig(Config):
    """Parameters of the friction estimate."""

    prior: float = param(0.4, "friction assumed before anything is known", live=True, gt=0.0)
    least: float = param(0.1, "friction is never taken for lower", live=True, gt=0.0)
    most: float = param(1.5, "friction is never taken for higher", live=True, gt=0.0)
    explore: float = param(
        0.05,
        "growth of an estimate that no slip has bounded yet, so that the squeeze is lowered until "
        "something slips a little",
        unit="1/s",
        live=True,
        ge=0.0,
    )
    forget: float = param(
        0.002, "growth of an estimate that slips have bounded", unit="1/s", live=True, ge=0.0
    )
    smoothing: float = param(
        0.02, "time constant of the forces of a contact that sticks", unit="s", live=True, gt=0.0
    )
    trust: float = param(
        0.05, "uncertainty of a slip's force ratio at which it counts half", live=True, gt=0.0
    )


class FrictionEstimator:
    """Bounds mu of one contact: sticking at a force ratio proves mu above it, slipping shows mu.

    A slip is read from its own samples only: those since the detector's sum left zero, which is
    Page's estimate of when it began. A contact that slides shows mu, one that the squeeze has
    caught shows less, so that the largest few ratios count. How much they count depends on how well
    they show: a contact that is hardly pressed tells next to nothing. An estimate grows the more
    slowly, the better slips have shown it, so that a false alarm is soon forgotten and a surface
    that slipped twice at the same ratio is not.

    Attributes:
        estimate: mu.
        confidence: How well slips have shown it, 0 to 1.
    """

    def __init__(self, config: FrictionConfig) -> None:
        """Start from the prior."""
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was learned."""
        self.estimate = self.config.prior
        self.confidence = self._caution = 0.0
        self._forget_forces()

    def _forget_forces(self) -> None:
        self._mean: Force | None = None
        self._variance = self._touched_for = 0.0
        self._slid: deque[Force] = deque(maxlen=_SAMPLES)
        self._reading = _Reading()
        self._before: tuple[float, float] | None = None
        self._quiet_for = 0.0

    def step(
        self, force: Force | None, state: Grip, evidence: float, dt: float, agrees: bool = True
    ) -> float:
        """Return the estimate after a tick.

        Args:
            force: Measured force in the contact frame (x, n, z), N; None where there is none.
            state: What the detector says of the contact.
            evidence: Its evidence for slip; zero: nothing slips.
            dt: Time since the last tick, s.
            agrees: Whether the newest sample tells of slip; one of a contact that the squeeze has
                caught says nothing of friction.
        """
        if force is None or state is Grip.UNKNOWN:
            self._forget_forces()
            return self.estimate
        self._follow(force, evidence, agrees)
        if state is Grip.SLIP:
            self._quiet_for = 0.0
            self._slip()
        else:
            self._quiet_for += dt
            if self._quiet_for > _AFTERSHOCKS:
                self._before = None
            self._stick(force, dt)
        c = self.config
        self.estimate = min(max(self.estimate, c.least), c.most)
        return self.estimate

    def _follow(self, force: Force, evidence: float, agrees: bool) -> None:
        """Read the force ratio since the evidence for a slip began."""
        if evidence <= 0.0:
            self._slid.clear()
            if self._before is None:
                self._reading = _Reading()
            return
        if not agrees:
            return
        self._slid.append(force)
        if len(self._slid) == _SAMPLES:
            self._reading.add(self._slid)

    def _slip(self) -> None:
        """Take the force ratio of a slip, as far as it can be trusted."""
        if self._before is None:
            self._before = self.estimate, self.confidence
        estimate, confidence = self._before
        ratio, weight = self._reading.ratio, self._reading.weight(self.config.trust)
        # What slips have shown before weighs against a single contrary one, maybe a false alarm.
        known, shown = _information(confidence), _information(weight)
        gain = shown / (1.0 + _INERTIA * known + shown)
        self.estimate = estimate + gain * (ratio - estimate)
        agrees = abs(ratio - estimate) < _AGREE * estimate
        # A weak contrary reading shakes what is known a little, a strong one replaces it.
        shaken = max(gain, confidence * (1.0 - weight))
        self.confidence = 1.0 - (1.0 - confidence) * (1.0 - weight) if agrees else shaken
        self._mean = None

    def hear(self, *others: FrictionEstimator) -> None:
        """Lower an estimate to what better known contacts with the same object have shown.

        A finger that hardly presses cannot learn from its own slips. Never the other way round:
        too low an estimate costs force, too high a one the object. Nor does an estimate grow faster
        than a lower one that is better known.
        """
        lower = [other for other in others if other.estimate < self.estimate]
        self._caution = max((other.confidence for other in lower), default=0.0)
        for other in lower:
            trust = 0.5 * other.confidence
            if other.estimate < self.estimate and trust > self.confidence:
                share = other.confidence * (1.0 - self.confidence)
                self.estimate += share * (other.estimate - self.estimate)
                self.confidence = trust

    def _stick(self, force: Force, dt: float) -> None:
        c = self.config
        growth = c.explore + max(self.confidence, self._caution) * (c.forget - c.explore)
        self.estimate = max(self.estimate * (1.0 + growth * dt), self._proven(force, dt))

    def _proven(self, force: Force, dt: float) -> float:
        """Return a force ratio that this contact has surely been sticking at."""
        if self._mean is None:
            self._mean, self._variance, self._touched_for = force, 0.0, 0.0
            return 0.0
        time = self.config.smoothing
        share = min(1.0, dt / time)
        off = [f - m for f, m in zip(force, self._mean, strict=True)]
        x, n, z = (m + share * d for m, d in zip(self._mean, off, strict=True))
        self._mean = x, n, z
        self._variance += share * (sum(d * d for d in off) / 3.0 - self._variance)
        self._touched_for += dt
        if self._touched_for < 3.0 * time:  # too early for the variance to be known
            return 0.0
        doubt = _SURE * math.sqrt(self._variance * share)
        return max(0.0, math.hypot(x, z) - doubt) / (n + doubt) if n > 0.0 else 0.0


def _information(confidence: float) -> float:
    """Return how much information, against none, makes one so confident."""
    return confidence / max(1.0 - confidence, 1e-9)


class _Reading:
    """Force ratio of a slip, and how sure it is."""

    def __init__(self) -> None:
        self._ratios: list[float] = []
        self._precision = 0.0

    def add(self, forces: deque[Force]) -> None:
        """Take some successive forces."""
        n = len(forces)
        x, normal, z = (sum(part) / n for part in zip(*forces, strict=True))
        if normal <= 0.0 or len(self._ratios) == _READINGS:
            return
        squares = sum((f[0] - x) ** 2 + (f[1] - normal) ** 2 + (f[2] - z) ** 2 for f in forces)
        variance = squares / (3.0 * n * (n - 1)) / normal**2 + _EXACT
        self._ratios.append(math.hypot(x, z) / normal)
        # Each force is part of n means, which are therefore not independent.
        self._precision += 1.0 / (n * variance)

    @property
    def ratio(self) -> float:
        """Mean of the largest few; 0 where nothing is known."""
        largest = sorted(self._ratios)[-_LARGEST:]
        return sum(largest) / len(largest) if largest else 0.0

    def weight(self, trust: float) -> float:
        """Return how much the ratio counts, 0 to 1; half where it is as uncertain as `trust`."""
        gain = trust * trust * self._precision
        return gain / (1.0 + gain)
