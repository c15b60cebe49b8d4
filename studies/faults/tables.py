# SPDX-License-Identifier: Apache-2.0
"""The campaign as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from studies.faults import space
from studies.faults.outcome import Outcome
from tactile_hand_ros.sweep.statistics import fraction_of

COLUMNS = (
    "",
    "runs",
    "drops",
    "95 % interval",
    "moved, worst [mm]",
    "safe, median [ms]",
    "peak / limit, worst",
    "recovered, median [s]",
)


def judged(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes that say something about a fault: the hand held when it came."""
    return [o for o in outcomes if not o.error]


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return a row for each way, situation and component, columns as in `COLUMNS`."""
    known = judged(outcomes)
    table = [row("all", [o for o in known if o.fault != space.NONE])]
    for way in space.WAYS:
        mine = [o for o in known if o.way == way]
        table.append(row(f"{way}, no fault", [o for o in mine if o.fault == space.NONE]))
        faulty = [o for o in mine if o.fault != space.NONE]
        table.append(row(f"{way}, all faults", faulty))
        deaths = [o for o in faulty if o.cell.is_death]
        if deaths:
            table.append(row(f"{way}, nodes killed or stopped", deaths))
        for attribute, values in (
            ("situation", space.SITUATIONS),
            ("component", space.FAULTS_OF),
            ("fault", _all_faults()),
        ):
            for value in values:
                some = [o for o in faulty if getattr(o, attribute) == value]
                if some:
                    table.append(row(f"{way}, {value}", some))
    return table


def _all_faults() -> list[str]:
    return list(dict.fromkeys(fault for faults in space.FAULTS_OF.values() for fault in faults))


def row(name: str, some: Sequence[Outcome]) -> list[str]:
    """Return the figures of some outcomes as text."""
    drops = [o.dropped for o in some]
    if not drops:
        return [name, "0", *["-"] * 6]
    _, low, high = fraction_of(sum(drops), len(drops))
    kept = _kept(some)
    return [
        name,
        str(len(some)),
        str(sum(drops)),
        f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
        _text([1e3 * o.moved for o in kept], max, "{:.1f}"),
        _text([1e3 * o.safe for o in some if o.safe is not None], np.median, "{:.0f}"),
        _text([o.peak / o.limit for o in some], max, "{:.2f}"),
        _text([o.recovered for o in some if o.recovered is not None], np.median, "{:.2f}"),
    ]


def _kept(some: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes with an object that was kept and moved by nothing but the fault."""
    return [o for o in some if not o.dropped and not math.isnan(o.moved)]


def _text(values: Sequence[float], of: Callable[[Any], Any], form: str) -> str:
    return form.format(float(of(values))) if values else "-"
