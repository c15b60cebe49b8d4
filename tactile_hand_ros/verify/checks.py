# SPDX-License-Identifier: Apache-2.0
"""What was checked at every tick of a recording, and how it is shown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Check:
    """One thing that was checked at every tick.

    Attributes:
        name: What was checked.
        ticks: Number of ticks.
        worst: Largest deviation.
        tolerance: What is allowed.
        unit: Of both.
        first: Stamp of the first tick that deviates more, ns; None if there is none.
        wrong: Number of such ticks.
    """

    name: str
    ticks: int
    worst: float
    tolerance: float
    unit: str
    first: int | None
    wrong: int

    @property
    def ok(self) -> bool:
        """Whether all ticks agree."""
        return self.wrong == 0


def check(
    name: str, record: Record, rows: NDArray[np.intp], worst: Array, tolerance: float, unit: str
) -> Check:
    """Sum up deviations at some ticks; NaN counts as wrong."""
    wrong = np.flatnonzero(~(worst <= tolerance))
    return Check(
        name,
        len(rows),
        float(worst.max()) if len(worst) else 0.0,
        tolerance,
        unit,
        int(record.stamps[rows[wrong[0]]]) if len(wrong) else None,
        len(wrong),
    )


def merged(checks: list[Check]) -> list[Check]:
    """Join the checks of one name, made at different ticks."""
    merged: dict[str, Check] = {}
    for check in checks:
        other = merged.setdefault(check.name, check)
        if other is not check:
            first = min((c.first for c in (other, check) if c.first is not None), default=None)
            merged[check.name] = replace(
                other,
                ticks=other.ticks + check.ticks,
                worst=float(np.maximum(other.worst, check.worst)),  # NaN if either is
                first=first,
                wrong=other.wrong + check.wrong,
            )
    return list(merged.values())


COLUMNS = ("check", "ticks", "worst", "allowed", "wrong", "first")


def rows(checks: list[Check]) -> list[list[str]]:
    """Return checks as text, columns as in `COLUMNS`."""
    return [
        [
            c.name,
            str(c.ticks),
            f"{c.worst:.2g} {c.unit}",
            f"{c.tolerance:.0g}",
            str(c.wrong) if c.wrong else "none",
            "" if c.first is None else f"{1e-9 * c.first:.3f} s",
        ]
        for c in checks
    ]
