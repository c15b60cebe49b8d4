# SPDX-License-Identifier: Apache-2.0
"""The squeeze that the joints can bear, beside whatever else they have to do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    beyond = np.abs(squeeze + rest) > limits
    if not beyond.any():
        return 1.0
    room = limits - np.sign(squeeze) * rest
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        shares = np.where(squeeze != 0.0, room / np.abs(squeeze), 1.0)
    return float(min(max(shares[beyond].min(), 0.0), 1.0))
