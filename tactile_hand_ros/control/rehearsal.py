# SPDX-License-Identifier: Apache-2.0
"""A made-up touch with which a block can go through a tick before the first real one comes.

What is compiled is loaded when it is first called, which takes some periods of a control loop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import Contacts, contact_frame

_RADIUS = 0.05  # m


def example_touch(fingers: int) -> tuple[Contacts, NDArray[np.float64]]:
    """Return k contacts around a cylinder and the forces on it in contact frames, (k, 3), N."""
    angles = 2.0 * np.pi * np.arange(fingers) / fingers
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros(fingers)], axis=1)
    frames = np.array([contact_frame(normal) for normal in -outward])
    return Contacts(_RADIUS * outward, frames), np.tile([0.0, 1.0, 0.0], (fingers, 1))
