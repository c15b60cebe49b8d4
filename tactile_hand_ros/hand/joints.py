# SPDX-License-Identifier: Apache-2.0
"""What the joints of a hand report."""

from __future__ import annotations

from typing import NamedTuple

from tactile_hand_ros.compiled import Array


class Joints(NamedTuple):
    """Report of the joints at a tick, arrays of shape (m,) in the hand's order.

    Attributes:
        theta: Joint angles, rad.
        rates: Joint rates, rad/s.
        applied: Torques since the tick before, N m; None if the driver does not report them.
    """

    theta: Array
    rates: Array
    applied: Array | None = None
