# SPDX-License-Identifier: Apache-2.0
"""The safe state of a hand that holds something: keep the squeeze, keep the posture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.model import Config, param

Array = NDArray[np.float64]


_FARTHEST, _FASTEST = np.pi, 1e3  # rad and rad/s; whatever is read, the torque stays finite


class HoldConfig(Config):
    """Stiffness of the safe hold."""

    bandwidth: float = param(
        40.0, "stiffness w of the hold: joints return like w^2 M_h", unit="rad/s", gt=0.0, le=1e3
    )


class SafeHold:
    """Holds the joints where they are, on top of the torque that squeezed the object.

    tau = tau_squeeze + M_h (w^2 (theta_hold - theta) - 2 w theta'). The squeeze never fades, which
    would drop the object, nor does it grow here, which would crush it: that is the regulator's to
    ask for.

    The spring bears more than a wrong squeeze: two fingers that press against each other with a
    constant torque buckle, as if there were a negative stiffness of force times lever, 11 N m/rad
    with 1 kg in the hand. Shaped by the inertia it may be as stiff as late torques allow: 40 rad/s
    stay damped at 250 Hz with torques that act three ticks late. A guard at the joints, without
    delay, holds stiffer; see `JointHold`.
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

    def torque(self, theta: Array, rates: Array, inertia: Array) -> Array:
        """Return the holding torque, shape (m,), N m; `engage` must have been called.

        Args:
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            inertia: M_h, shape (m, m), kg m^2.
        """
        assert self._posture is not None
        w = self._config.bandwidth
        away = np.clip(self._posture - theta, -_FARTHEST, _FARTHEST)
        rates = np.clip(rates, -_FASTEST, _FASTEST)
        return np.asarray(self._squeeze + inertia @ (w * w * away - 2.0 * w * rates))
