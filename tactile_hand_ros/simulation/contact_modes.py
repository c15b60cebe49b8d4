# SPDX-License-Identifier: Apache-2.0
"""Starting points for hard contact problems: every combination of stick, slip and open.

Given the mode of each contact and the directions in which some slide, the laws are linear: w = 0
where it sticks, w_n = 0 and p_t = -mu p_n u where it slips along u, p = 0 where it is open. The
directions follow from the velocities that come out. That is not safe to converge, but it is near
enough for Newton's method if these are the modes of a solution.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.compiled import compiled
from tactile_hand_ros.simulation.alart_curnier import Laws
from tactile_hand_ros.simulation.elimination import eliminate

Array = NDArray[np.float64]

STICK, SLIP, OPEN = 0, 1, 2
_TURNS = 4  # times that the directions of sliding are brought up to date


@compiled
def impulses_of_modes(laws: Laws, combination: int) -> Array:
    """Return impulses, shape (3c,), N s, that obey the laws of chosen modes, or nearly so.

    Args:
        laws: The laws.
        combination: The modes of the contacts as digits to base 3, from 0 to 3^c - 1.
    """
    w, b, mu, r, _ = laws
    n = len(b)
    velocities, p = b, np.zeros(n)
    for _ in range(_TURNS):
        matrix, right, digits = np.zeros((n, n)), np.zeros(n), combination
        slips = False
        for x in range(0, n, 3):
            mode, digits = digits % 3, digits // 3
            if mode == OPEN:
                for j in range(x, x + 3):
                    matrix[j, j] = 1.0 / r[j]
                continue
            for j in range(x, x + 3):
                matrix[j], right[j] = w[j], -b[j]
            if mode == SLIP:
                slips = True
                speed = math.hypot(velocities[x], velocities[x + 2])
                for j in (x, x + 2):
                    matrix[j], right[j] = 0.0, 0.0
                    matrix[j, j] = 1.0 / r[j]
                    if speed > 0.0:
                        matrix[j, x + 1] = mu[x // 3] * velocities[j] / (speed * r[j])
        p = eliminate(matrix, right)
        if not slips:
            break
        velocities = w @ p + b
    return p
