# SPDX-License-Identifier: Apache-2.0
"""Whether contacts lie on the fingertips, and whether f* is an answer to (13)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.hand.kinematics import Fingertips

Array = NDArray[np.float64]

_SUM = 1e-3  # largest error of sum f*_n = 1


def implausible_touch(tips: Fingertips, radii: Array, contacts: Contacts, tolerance: float) -> str:
    """Return why contacts and joints do not fit each other; empty if they do.

    Args:
        tips: Fingertips of the measured posture.
        radii: Radii of the fingertips, shape (k,), m.
        contacts: Contact points and frames; all must touch.
        tolerance: Largest distance between a contact and its fingertip, m.
    """
    gap = _largest_gap(tips.positions, radii, contacts.positions, contacts.rotations)
    if gap <= tolerance:
        return ""
    return f"a contact is {1e3 * gap:.0f} mm off its fingertip; holding until joints and touch fit"


def implausible_shape(optimal_forces: Array) -> str:
    """Return why f*, shape (k, 3), is no answer to (13); empty if it may be one."""
    total = float(optimal_forces[:, 1].sum())
    if math.fabs(total - 1.0) <= _SUM:
        return ""
    return f"the normal parts of f* add up to {total:.3g} instead of 1; holding until they do"


class JointWatch:
    """Finds joint angles that repeat to the bit although the contacts move."""

    def __init__(self) -> None:
        """Start without a past."""
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._theta: Array | None = None
        self._points = np.zeros((0, 3))

    def step(self, theta: Array, contacts: Contacts, tolerance: float) -> str:
        """Return why the joints are implausible; empty if they are not.

        Args:
            theta: Joint angles, shape (m,), rad.
            contacts: Contact points and frames; all must touch.
            tolerance: Distance that contacts may move under joints that stand still, m.
        """
        if self._theta is None or not np.array_equal(theta, self._theta):
            self._theta, self._points = theta.copy(), contacts.positions
            return ""
        if np.abs(contacts.positions - self._points).max() <= tolerance:
            return ""
        return "the joint angles do not change although the contacts move; holding until they do"


@compiled
def _largest_gap(centres: Array, radii: Array, points: Array, rotations: Array) -> float:
    """Return the largest |p_c - p_f - r n|, m."""
    largest = 0.0
    for i in range(len(points)):
        square = 0.0
        for axis in range(3):
            gap = points[i, axis] - centres[i, axis] - radii[i] * rotations[i, axis, 1]
            square += gap * gap
        largest = max(largest, square)
    return math.sqrt(largest)
