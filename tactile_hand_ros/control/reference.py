# SPDX-License-Identifier: Apache-2.0
"""A smooth way to a desired pose: stiff gains need not jerk at the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.rotations import rodrigues, vector_from_rotation

Array = NDArray[np.float64]


class SmoothReference:
    """Follows desired poses like a critically damped spring, from where the grasp is.

    x'' = (x_d - x) / T^2 - 2 x' / T, the same for the rotation vector to the desired orientation.
    """

    def __init__(self) -> None:
        """Start without a pose."""
        self.reset()

    def reset(self) -> None:
        """Forget where the reference is."""
        self._pose: Target | None = None
        self._velocity, self._spin = np.zeros(3), np.zeros(3)

    def step(self, target: Target, now: AuxiliaryPose, time: float, dt: float) -> Target:
        """Return the pose to follow at this tick.

        Args:
            target: Desired pose.
            now: Pose of the grasp, from which the first step begins.
            time: T in s; 0 gives the desired pose itself.
            dt: Time since the last tick, s.
        """
        if time <= 0.0:
            self._pose = None
            return target
        if self._pose is None:
            self._pose = Target(now.position, now.orientation)
            self._velocity, self._spin = np.zeros(3), np.zeros(3)
        position, orientation, self._velocity, self._spin = _followed(
            *self._pose, self._velocity, self._spin, *target, time, dt
        )
        self._pose = Target(position, orientation)
        return self._pose


@compiled
def _followed(
    position: Array,
    orientation: Array,
    velocity: Array,
    spin: Array,
    desired_position: Array,
    desired_orientation: Array,
    time: float,
    dt: float,
) -> tuple[Array, Array, Array, Array]:
    """Return pose, velocity and spin of the reference after a time dt, in s."""
    turn = vector_from_rotation(desired_orientation @ orientation.T)
    missing = desired_position - position
    velocity = velocity + dt * (missing / time**2 - 2.0 * velocity / time)
    spin = spin + dt * (turn / time**2 - 2.0 * spin / time)
    turned = rodrigues(dt * spin[0], dt * spin[1], dt * spin[2])
    return position + dt * velocity, turned @ orientation, velocity, spin
