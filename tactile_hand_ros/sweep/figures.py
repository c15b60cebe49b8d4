# SPDX-License-Identifier: Apache-2.0
"""The figure of a sweep: each metric against each parameter, a dot for each run."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from tactile_hand_ros.report.style import PAGE, finger_color, look, new_figure
from tactile_hand_ros.sweep.engine import OUTCOMES, REACHED
from tactile_hand_ros.sweep.results import Results
from tactile_hand_ros.sweep.space import Range

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PARAMETERS = 4  # that fit next to each other


def figure(results: Results) -> Figure | None:
    """Draw all runs, colored by outcome; None without a parameter of numbers."""
    paths = list(results.parameters)[:_MOST_PARAMETERS]
    if not paths or not len(results.table["outcome"]):
        return None
    names = [name for name in results.metrics if np.isfinite(results.column(name)).any()]
    names = names or [REACHED]
    with look():
        made = new_figure(PAGE if len(paths) > 1 else 0.6 * PAGE, 0.5 + 1.5 * len(names))
        panels = made.subplots(len(names), len(paths), squeeze=False, sharey="row", sharex="col")
        for row, name in enumerate(names):
            for column, path in enumerate(paths):
                _draw(panels[row, column], results, path, name)
            panels[row, 0].set_ylabel(_label(name))
        for column, path in enumerate(paths):
            panels[-1, column].set_xlabel(path)
        made.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return made


def _draw(axes: Axes, results: Results, path: str, name: str) -> None:
    x, y, outcomes = results.column(path), results.column(name), results.table["outcome"]
    for number, outcome in enumerate(OUTCOMES):
        came = outcomes == outcome
        axes.plot(x[came], y[came], ".", color=finger_color(number), markersize=2.5, label=outcome)
    parameter = results.parameters[path]
    if isinstance(parameter, Range) and parameter.is_log:
        axes.set_xscale("log")


def _label(name: str) -> str:
    """Return a column as people write it: its unit in brackets, in short lines."""
    words, _, unit = name.rpartition("_")
    words, unit = (words, f" [{unit}]") if unit in ("m", "rad", "N", "s") else (name, "")
    return textwrap.fill(words.replace("_", " ") + unit, 18)
