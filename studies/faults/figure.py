# SPDX-License-Identifier: Apache-2.0
"""The campaign as a figure: drops by component and fault, and the times to safety."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studies.faults import space, tables
from studies.faults.outcome import Outcome
from tactile_hand_ros.report.style import PAGE, finger_color, label_panel, look, new_figure
from tactile_hand_ros.sweep.statistics import share

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHT = 3.4


def faults_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Draw the share of drops of each component with its interval, and the time to safety."""
    known = tables.judged(outcomes)
    with look():
        figure = new_figure(PAGE, _HEIGHT)
        left, right = figure.subplots(1, 2)
        _draw_drops(left, known)
        _draw_safe(right, known)
    return figure


def _draw_drops(axes: Axes, known: Sequence[Outcome]) -> None:
    parts = list(space.FAULTS_OF)
    for i, way in enumerate(space.WAYS):
        mine = [o for o in known if o.way == way and o.fault != space.NONE]
        name: str | None = way
        for row, part in enumerate(parts):
            drops = [o.dropped for o in mine if o.component == part]
            if drops:
                middle, low, high = (100.0 * value for value in share(drops))
                at = row + 0.22 * (i - 1)
                axes.plot([low, high], [at, at], color=finger_color(i), linewidth=1.2)
                axes.plot([middle], [at], "o", color=finger_color(i), markersize=3.5, label=name)
                name = None
    axes.set_yticks(range(len(parts)), parts)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("drops [%], 95 % interval")
    axes.legend()
    label_panel(axes, "a", "which part failed")


def _draw_safe(axes: Axes, known: Sequence[Outcome]) -> None:
    for i, way in enumerate(space.WAYS):
        times = sorted(1e3 * o.safe for o in known if o.way == way and o.safe is not None)
        if times:
            shares = np.arange(1, len(times) + 1) / len(times)
            axes.step(np.maximum(times, 0.1), shares, color=finger_color(i), label=way)
    axes.set_xscale("log")
    axes.set_ylim(0.0, 1.0)
    axes.set_xlabel("time to a declared safe state [ms]")
    axes.set_ylabel("share of what was declared")
    label_panel(axes, "b", "how soon")
