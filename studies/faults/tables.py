# SPDX-License-Identifier: Apache-2.0
"""The campaign as tables and files."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.faults import situations, space
from studies.faults.outcome import Outcome
from tactile_hand_ros.run.metrics import json_ready
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


def survivability() -> list[dict[str, Any]]:
    """Return what an ideal hold makes of each situation: where it drops, no cell is survivable."""
    return [
        {
            "way": way,
            "situation": situation,
            "survivable": not situations.ideal(situation, way).is_dropped,
            "moved_mm": round(1e3 * situations.ideal(situation, way).moved, 3),
            "peak_N": round(situations.ideal(situation, way).peak, 1),
        }
        for way in space.WAYS
        for situation in space.SITUATIONS
    ]


def write(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """Write all outcomes as CSV, and tables and survivability as JSON; return the files."""
    table, summary = folder / "faults.csv", folder / "faults.json"
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(Outcome.__dataclass_fields__))
        writer.writeheader()
        writer.writerows(outcome.data() for outcome in outcomes)
    content = {
        "runs": len(outcomes),
        "judged": len(judged(outcomes)),
        "started again before the fault": sum(o.starts - 1 for o in outcomes),
        "not judged": [o.error for o in outcomes if o.error],
        "columns": COLUMNS,
        "rows": rows(outcomes),
        "survivability": survivability(),
        "cells": [_cell(cell, outcomes) for cell in space.cells()],
    }
    summary.write_text(json.dumps(json_ready(content), indent=1) + "\n", encoding="utf-8")
    return [table, summary]


def _cell(cell: space.Cell, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    some = [o for o in judged(outcomes) if o.cell == cell]
    probable, low, high = fraction_of(sum(o.dropped for o in some), len(some))
    return {
        **cell._asdict(),
        "runs": len(some),
        "drops": sum(o.dropped for o in some),
        "drop_fraction": probable,
        "interval": [low, high],
        "moved_m": max((o.moved for o in _kept(some)), default=math.nan),
        "safe_s": [o.safe for o in some],
        "peak_fraction": max((o.peak / o.limit for o in some), default=math.nan),
        "recovered_s": [o.recovered for o in some],
    }
