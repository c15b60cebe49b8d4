# SPDX-License-Identifier: Apache-2.0
"""The friction of a contact, learned from its slips and sticks only."""

from __future__ import annotations

import math
from collections import deque

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.slip_detector import Force, Grip

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
    """Bounds mu of one contact: sticking at a force ratio proves mu above it, slipping shows mu.

    Attributes:
        estimate: mu.
        learned: Whether a slip has shown it.
    """

    def __init__(self, config: FrictionConfig) -> None:
        """Start from the prior."""
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was learned."""
        self.estimate = self.config.prior
        self.learned = False
        self._ratio = self._peak = 0.0
        self._slid = False
        self._recent: deque[Force] = deque(maxlen=_SAMPLES)

    def step(self, force: Force | None, state: Grip, dt: float) -> float:
        """Return the estimate after a tick.

        Args:
            force: Measured force in the contact frame (x, n, z), N; None where there is none.
            state: What the detector says of the contact.
            dt: Time since the last tick, s.
        """
        if force is None or state is Grip.UNKNOWN:
            self._ratio = self._peak = 0.0
            self._slid = False
            self._recent.clear()
            return self.estimate
        c = self.config
        ratio = math.hypot(force[0], force[2]) / force[1]
        self._ratio += min(1.0, dt / c.smoothing) * (ratio - self._ratio)
        around = self._ratio_around(force)
        # The peak fades within the window, so that it tells of the last moments only.
        self._peak = max(around, (1.0 - min(1.0, dt / c.window)) * self._peak)
        if state is Grip.SLIP:
            self._slip(around)
        else:
            self._stick(dt)
        self._slid = state is Grip.SLIP
        self.estimate = min(max(self.estimate, c.least), c.most)
        return self.estimate

    def _ratio_around(self, force: Force) -> float:
        """Return the force ratio of the mean of the last samples, against noise."""
        self._recent.append(force)
        normal = sum(f[1] for f in self._recent)
        if normal <= 0.0:
            return 0.0
        return math.hypot(sum(f[0] for f in self._recent), sum(f[2] for f in self._recent)) / normal

    def _stick(self, dt: float) -> None:
        growth = self.config.forget if self.learned else self.config.explore
        self.estimate = max(self.estimate * (1.0 + growth * dt), self._ratio)

    def _slip(self, ratio: float) -> None:
        """Take the largest force ratio around the detection of a slip.

        A contact that slides shows mu; one that sticks, before or since, shows less. Detection
        needs some samples, in which the squeeze may already have caught the object.
        """
        self.estimate = max(self.estimate, ratio) if self._slid else self._peak
        self.learned = True
