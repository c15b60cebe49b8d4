# SPDX-License-Identifier: Apache-2.0
"""The safe state of a hand that holds something: keep the squeeze, keep the posture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param

Array = NDArray[np.float64]


class HoldConfig(Config):
    """Stiffness of the safe hold."""

    stiffness: float = param(10.0, "joint stiffness of the hold", unit="N m/rad", gt=0.0, le=1e4)
    damping: float = param(0.5, "joint damping of the hold", unit="N m s/rad", ge=0.0, le=1e3)


class SafeHold:
    """Holds the joints where they are, on top of the torque that squeezed the object.

    tau = tau_squeeze + K (theta_hold - theta) - D theta'. The squeeze never fades, which would drop
    the object, nor does it grow here, which would crush it: that is the regulator's to ask for. The
    spring keeps a wrong squeeze from moving the hand far.
    """

    def __init__(self, config: HoldConfig) -> None:
        """Start released."""
        self._config = config
        self._posture: Array | None = None
        self._squeeze = np.zeros(0)

    @property
    def active(self) -> bool:
        """Whether the joints are held."""
        return self._posture is not None

    def engage(self, theta: Array, squeeze: Array) -> None:
        """Hold from now on; has no effect while already holding.

        Args:
            theta: Posture to hold, shape (m,), rad.
            squeeze: Torque to keep, shape (m,), N m.
        """
        if self._posture is None:
            self._posture, self._squeeze = theta.copy(), squeeze.copy()

    def move(self, theta: Array, squeeze: Array) -> None:
        """Hold another posture with another torque from now on, both of shape (m,)."""
        self._posture, self._squeeze = theta, squeeze

    def release(self) -> None:
        """Let go of the posture."""
        self._posture = None

    def torque(self, theta: Array, rates: Array) -> Array:
        """Return the holding torque, shape (m,), N m; `engage` must have been called."""
        assert self._posture is not None
        spring = self._config.stiffness * (self._posture - theta)
        return np.asarray(self._squeeze + spring - self._config.damping * rates)
