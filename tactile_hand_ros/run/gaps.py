# SPDX-License-Identifier: Apache-2.0
"""Ticks that a recording lacks: they say nothing about the hand, and no contact is lost in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record

_LONG = 5
"""Ticks that must be missing for a gap: in real time, a plant that is late skips some."""


def silent(record: Record) -> NDArray[np.bool_]:
    """Return the ticks at which touch says nothing because its messages are missing, shape (n,).

    A hand that has lost all contacts says so: without positions, and with forces of zero.
    """
    missing = np.isnan(record.contact_positions[:, :, 0]).all(axis=1)
    forces = record.forces[:, :, 1]
    return np.asarray(missing & (np.isnan(forces).all(axis=1) | (forces > 0.0).any(axis=1)))


def gaps(record: Record) -> list[tuple[int, int]]:
    """Return first and last row around each stretch of missing ticks or of silence.

    The rows themselves are recorded; the run is unknown between them.
    """
    if len(record) < 3:
        return []
    steps = np.diff(record.stamps)
    period = float(np.median(steps))
    found = [(int(row), int(row) + 1) for row in np.flatnonzero(steps > _LONG * period)]
    quiet = silent(record)
    if quiet.all():  # without touch altogether
        return found
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start >= _LONG:
            found.append((max(0, int(start) - 1), min(int(end), len(record) - 1)))
    return sorted(found)
