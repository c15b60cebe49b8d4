# SPDX-License-Identifier: Apache-2.0
"""The squeeze that the joints can bear, beside whatever else they have to do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled

Array = NDArray[np.float64]


@compiled
def bearable_share(squeeze: Array, rest: Array, limits: Array) -> float:
    """Return the largest share s of a squeeze for which |s squeeze + rest| stays within limits.

    A joint at its limit gives less than it is asked for and so bends the shape of the squeeze: the
    forces no longer balance and push the object away. The same share of all joints keeps the shape.

    Args:
        squeeze: Torque of the squeeze, shape (m,), N m.
        rest: All other torque, shape (m,), N m.
        limits: Effort limits of the joints, shape (m,), N m.

    Returns:
        From 0 to 1; 1 where the limits allow the whole squeeze.
    """
    share = 1.0
    for i in range(len(limits)):
        if abs(squeeze[i] + rest[i]) > limits[i] and squeeze[i] != 0.0:
            room = limits[i] - np.sign(squeeze[i]) * rest[i]
            share = min(share, room / abs(squeeze[i]))
    return max(share, 0.0)
