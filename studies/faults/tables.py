# SPDX-License-Identifier: Apache-2.0
"""The campaign as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.faults import space
from tactile_hand_ros.sweep.engine import FAILED, LOST
from tactile_hand_ros.sweep.results import fraction_of
from tactile_hand_ros.sweep.table import Table

COLUMNS = (
    *("", "runs", "drops", "95 % interval", "moved, worst [mm]", "safe, median [ms]"),
    *("peak / limit, worst", "recovered, median [s]"),
)


def rows(tables: Sequence[Table]) -> list[list[str]]:
    """Return a row for each way, situation, component and fault; columns as in `COLUMNS`."""
    found = []
    for table in tables:
        judged = table["outcome"] != FAILED  # failed runs started without a grasp
        way, is_none = str(table["way"][0]), table["fault"] == space.NONE
        faulty = judged & ~is_none
        found.append(row(f"{way}, no fault", table, judged & is_none))
        found.append(row(f"{way}, all faults", table, faulty))
        killed = np.isin(table["fault"], space.DEADLY) & np.isin(table["component"], space.HAND)
        if way != "in-process":
            found.append(row(f"{way}, nodes killed or stopped", table, faulty & killed))
        for name in ("situation", "component", "fault"):
            for value in dict.fromkeys(table[name][faulty]):
                found.append(row(f"{way}, {value}", table, faulty & (table[name] == value)))
    return found


def row(name: str, table: Table, chosen: NDArray[np.bool_]) -> list[str]:
    """Return the results of some runs as text."""
    some = {key: column[chosen] for key, column in table.items()}
    runs, drops = int(chosen.sum()), int((some["outcome"] == LOST).sum())
    if not runs:
        return [name, "0", *["-"] * 6]
    _, low, high = fraction_of(drops, runs)
    return [
        *(name, str(runs), str(drops), f"{100.0 * low:.1f} to {100.0 * high:.1f} %"),
        _text(1e3 * some["moved"][some["outcome"] != LOST], np.max, "{:.1f}"),
        _text(1e3 * some["safe"], np.median, "{:.0f}"),
        _text(some["peak"] / some["limit"], np.max, "{:.2f}"),
        _text(some["recovered"], np.median, "{:.2f}"),
    ]


def _text(values: Any, of: Callable[[Any], Any], form: str) -> str:
    known = values[~np.isnan(values)]
    return form.format(float(of(known))) if len(known) else "-"
