# SPDX-License-Identifier: Apache-2.0
"""Random loads as a table, a figure and data: comfort against safety over the reserve."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_hand_ros.report import tables
from tactile_hand_ros.report.style import PAGE, finger_color, look, new_figure
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.studies.slip.loads import LoadOutcome, TradeOff, trade_offs
from tactile_hand_ros.studies.statistics import share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("floor of the reserve", "loads", "squeeze before", "lost", "slid over 5 mm")


def rows(outcomes: Sequence[LoadOutcome]) -> list[list[str]]:
    """Return the curve as text, columns as in `COLUMNS`."""
    return [_row(point) for point in trade_offs(outcomes)]


def _row(point: TradeOff) -> list[str]:
    counts = [_text(point.lost, point.runs), _text(point.slid, point.runs)]
    return [f"{point.floor:g} N", str(point.runs), f"{point.squeeze:.1f} N", *counts]


def _text(count: int, runs: int) -> str:
    value, low, high = share([i < count for i in range(runs)])
    return f"{100 * value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def loads_figure(outcomes: Sequence[LoadOutcome]) -> Figure:
    """Draw what is lost and what slides against the squeeze before the load."""
    curve = trade_offs(outcomes)
    squeezes = [point.squeeze for point in curve]
    with look():
        figure = new_figure(PAGE, 2.6)
        axes = figure.subplots()
        for i, name in enumerate(("slid", "lost")):
            shares = [100.0 * getattr(point, name) / max(point.runs, 1) for point in curve]
            axes.plot(squeezes, shares, "o-", color=finger_color(i), markersize=3.5, label=name)
        for point in curve:
            axes.annotate(f"{point.floor:g} N", (point.squeeze, 0.0), fontsize=7)
        axes.set_xlabel("mean squeeze before the load [N], by floor of the reserve")
        axes.set_ylabel("share of the loads [%]")
        axes.legend()
    return figure


def write(outcomes: Sequence[LoadOutcome], folder: Path) -> list[Path]:
    """Write all outcomes as JSON and the table as Markdown; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    report, data = folder / "study_loads.md", folder / "study_loads.json"
    report.write_text(tables.markdown(COLUMNS, rows(outcomes)), encoding="utf-8")
    text = json.dumps(json_ready([asdict(outcome) for outcome in outcomes]), indent=1)
    data.write_text(text + "\n", encoding="utf-8")
    return [report, data]
