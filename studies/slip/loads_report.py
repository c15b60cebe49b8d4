# SPDX-License-Identifier: Apache-2.0
"""Random loads as a table and a figure: comfort against safety over the reserve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from studies.slip.loads import LoadOutcome, TradeOff, trade_offs
from tactile_hand_ros.report import tables
from tactile_hand_ros.report.style import PAGE, finger_color, look, new_figure
from tactile_hand_ros.sweep.statistics import share_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {"slid": "slid over 5 mm", "lost": "lost"}
COLUMNS = ("floor", "share", "loads", "squeeze before", "over need", "lost", "slid over 5 mm")


def rows(outcomes: Sequence[LoadOutcome]) -> list[list[str]]:
    """Return the curve as text, columns as in `COLUMNS`."""
    return [_row(point) for point in trade_offs(outcomes)]


def _row(point: TradeOff) -> list[str]:
    reserve = [f"{point.floor:g} N", f"{100 * point.share:g} %", str(point.runs)]
    squeeze = [f"{point.squeeze:.1f} N", f"{point.squeeze / point.need:.1f}"]
    return reserve + squeeze + [_text(point.lost, point.runs), _text(point.slid, point.runs)]


def _text(count: int, runs: int) -> str:
    value, low, high = share_of(count, runs)
    return f"{100 * value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def loads_figure(outcomes: Sequence[LoadOutcome]) -> Figure:
    """Draw what slides and what is lost against the squeeze before the load, per least squeeze."""
    curve = trade_offs(outcomes)
    with look():
        figure = new_figure(PAGE, 2.6)
        axes = figure.subplots()
        for share, marker in zip(sorted({point.share for point in curve}), "svo^", strict=False):
            some = [point for point in curve if point.share == share]
            over = [point.squeeze / point.need for point in some]
            for i, name in enumerate(("slid", "lost")):
                shares = [100.0 * getattr(point, name) / max(point.runs, 1) for point in some]
                label = f"{LABELS[name]}, share {100 * share:g} %"
                axes.plot(over, shares, f"{marker}-", color=finger_color(i), ms=3.5, label=label)
        for point in some:
            place = point.squeeze / point.need, 100.0 * point.slid / max(point.runs, 1)
            axes.annotate(f" {point.floor:g} N", place, fontsize=7, va="bottom")
        axes.set_xlabel("mean squeeze before the load per least squeeze, by floor of the reserve")
        axes.set_ylabel("share of the loads [%]")
        axes.legend()
    return figure


def write(outcomes: Sequence[LoadOutcome], folder: Path) -> Path:
    """Write the table as Markdown and return the file."""
    report = folder / "study_loads.md"
    report.write_text(tables.markdown(COLUMNS, rows(outcomes)), encoding="utf-8")
    return report
