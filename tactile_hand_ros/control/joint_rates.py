# SPDX-License-Identifier: Apache-2.0
"""Joint rates from the angles of an encoder, without the pulses that its steps make."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]

_WINDOW = 64  # angles that are looked at; at rest their slope is an error of an angle over all
_ROUNDING = 0.01  # of the error: angles that differ by just one step are on a line too


class JointRates:
    """Estimates rates over the longest past in which the angles lie on a line.

    Behind a filter with a fixed corner frequency each step of an encoder is a pulse of the rate,
    however slowly the joint moves, and damping makes a pulse of force of it. Here the window is as
    long as all angles, within their error, lie on the line from its first to its last. At rest and
    at a constant speed it is long, so that a step counts for little. At an acceleration a it lasts
    about sqrt(8 e / a), with the error e.

    Source: Janabi-Sharifi, Hayward, Chen, Discrete-time adaptive windowing for velocity estimation,
    2000, the end-fit rule.

    Attributes:
        error: How far the rates may be off, an error of an angle over the window, shape (m,),
            rad/s.
    """

    def __init__(self, joints: int) -> None:
        """Start without a past of m joints."""
        self._angles = np.zeros((_WINDOW, joints))
        self._times = np.zeros(_WINDOW)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._count, self.error = 0, np.zeros(self._angles.shape[1])

    def step(self, stamp: int, theta: Array, rates: Array, error: float) -> Array:
        """Return the rates at a tick, shape (m,), rad/s.

        Args:
            stamp: The tick, ns.
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates as measured, shape (m,), rad/s: the answer where the angles are
                exact, or have no past.
            error: Of an angle, rad; 0 where they are exact.
        """
        if error == 0.0:
            return rates
        time, before = 1e-9 * stamp, self._times[(self._count - 1) % _WINDOW]
        if self._count and time <= before:  # the same tick again, or all starts over
            self._count = self._count - 1 if time == before else 0
        self._times[self._count % _WINDOW], self._angles[self._count % _WINDOW] = time, theta
        self._count += 1
        if self._count == 1:
            return rates
        rates, lengths = _slopes(self._times, self._angles, self._count, (1.0 + _ROUNDING) * error)
        self.error = error / lengths
        return rates


@compiled
def _slopes(times: Array, angles: Array, count: int, error: float) -> tuple[Array, Array]:
    """Return the slopes of the longest lines, rad/s, and their lengths, s, each of shape (m,).

    Args:
        times: Ring of times, shape (n,), s.
        angles: Ring of angles, shape (n, m), rad.
        count: How many were ever written; the last is the newest.
        error: Of an angle, rad.
    """
    n, newest = len(times), (count - 1) % len(times)
    slopes, lengths = np.zeros(angles.shape[1]), np.zeros(angles.shape[1])
    for joint in range(angles.shape[1]):
        low, high = -np.inf, np.inf  # slopes that pass all angles so far
        for back in range(1, min(count, n)):
            at = (count - 1 - back) % n
            passed = times[newest] - times[at]
            moved = angles[newest, joint] - angles[at, joint]
            if not low <= moved / passed <= high:
                break
            slopes[joint], lengths[joint] = moved / passed, passed
            low = max(low, (moved - error) / passed)
            high = min(high, (moved + error) / passed)
    return slopes, lengths
