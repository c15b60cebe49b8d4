# SPDX-License-Identifier: Apache-2.0
"""The reflex: how the squeeze rises when grip is lost, and comes back afterwards."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.slip.need import NeedConfig

_LONGEST = 0.02  # s that a pause counts for at most: nothing is known of it
_CALM = 0.05  # s without slip after which the next is a new one, met from the present squeeze


class ReflexConfig(Config):
    """Parameters of the reflex that keeps an object from slipping."""

    margin: float = param(
        0.15, "share by which the squeeze exceeds what the friction needs", live=True, ge=0.0
    )
    rise_rate: float = param(4000.0, "fastest rise of the squeeze", unit="N/s", live=True, gt=0.0)
    first_rise: float = param(
        2.0,
        "factor by which the squeeze rises when a slip begins or a contact is lost",
        live=True,
        ge=1.0,
    )
    doubling_time: float = param(
        0.01, "time in which the squeeze doubles while something slips", unit="s", live=True, gt=0.0
    )
    release_rate: float = param(
        1.0, "least fall of the squeeze towards what is needed", unit="N/s", live=True, gt=0.0
    )
    release_time: float = param(
        0.5, "time constant with which a large excess falls", unit="s", live=True, gt=0.0
    )
    need: NeedConfig = NeedConfig()


class Reflex:
    """Follows the need, and goes beyond it while the need cannot be known.

    A contact that slides feels only what friction lets through, and a grasp that has lost a contact
    has no need that could be computed: both say that the squeeze is too small, not by how much. The
    squeeze then doubles at once, and again in every `doubling_time` in which the skin goes on
    telling of slip, or a contact that is left after another was lost is at the edge of its cone.

    Attributes:
        squeeze: What it asks for, N.
    """

    def __init__(self, config: ReflexConfig, squeeze: float) -> None:
        """Start at a squeeze in N."""
        self.config = config
        self.start(squeeze)

    def start(self, squeeze: float) -> None:
        """Go on from a squeeze in N, without a grasp that could be lost."""
        self.squeeze = self._settled = squeeze
        self._calm_for = self._grown = 0.0
        self._whole = False

    def step(
        self,
        needed: float,
        slips: bool,
        slides: bool,
        touching: NDArray[np.bool_],
        limit: float,
        dt: float,
    ) -> float:
        """Return the squeeze after a tick, N.

        Args:
            needed: Squeeze that load and friction ask for, N; not finite while unknown.
            slips: Whether a slip goes on.
            slides: Whether the newest samples show it too; with a contact lost also whether one
                that is left carries all that its friction is trusted with.
            touching: Which contacts touch, shape (k,).
            limit: Largest squeeze, N.
            dt: Time since the last tick, s.
        """
        c = self.config
        touches = touching.tolist()
        whole, some = all(touches), any(touches)
        goal = needed if math.isfinite(needed) else self.squeeze
        goal = max(goal, self._startled(slips, slides, whole, some, limit, dt))
        if not some:  # nothing is left that a squeeze could hold
            goal = self._settled
        falls = max(c.release_rate, (self.squeeze - goal) / c.release_time)
        low, high = self.squeeze - falls * dt, self.squeeze + c.rise_rate * dt
        self.squeeze = min(max(goal, low), high, limit)
        return self.squeeze

    def _startled(
        self, slips: bool, slides: bool, whole: bool, some: bool, limit: float, dt: float
    ) -> float:
        """Return the squeeze that a slip or a lost contact asks for, N; 0 without either."""
        lost = self._whole and not whole
        self._whole = whole or (lost and some)
        if not slips and not lost:
            self._calm_for += dt
            if self._calm_for > _CALM and whole:
                self._settled = self.squeeze
            self._grown = 0.0
            return 0.0
        c = self.config
        self._calm_for = 0.0
        self._grown = max(self._grown, c.first_rise * self._settled)
        if slides:
            growth = math.exp(min(dt, _LONGEST) / c.doubling_time * math.log(2.0))
            self._grown = min(growth * max(self._grown, self.squeeze), limit)
        return self._grown
