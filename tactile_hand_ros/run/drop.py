# SPDX-License-Identifier: Apache-2.0
"""Whether the hand still holds the object at the end of a run, and if not, since when."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.run.gaps import silent

_HOLDING = 2
"""Fingers that it takes to hold an object."""


def dropped_at(record: Record, releases: Sequence[float] = ()) -> float:
    """Return when the object was dropped, s; NaN if it is held at the end, or was never held.

    It counts as dropped from the tick on at which fewer than two fingers touch for good, by touch.

    Args:
        record: The run.
        releases: When a user let the hand open, s; what is let go is not dropped.
    """
    missing = np.isnan(record.contact_positions[:, :, 0])
    known = np.flatnonzero(~silent(record))  # of the other ticks, nothing was recorded
    held = np.flatnonzero((~missing[known]).sum(axis=1) >= _HOLDING)
    if not len(held) or held[-1] + 1 == len(known):
        return math.nan
    time = float(record.times[known[held[-1] + 1]])
    return math.nan if any(release <= time for release in releases) else time
