# SPDX-License-Identifier: Apache-2.0
"""Figures of a sweep: success over two parameters, and metrics against parameters."""

from __future__ import annotations

import itertools
import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.report.style import FAINT, PAGE, look, new_figure, run_color
from tactile_hand_ros.sweep.engine import REACHED
from tactile_hand_ros.sweep.results import Results
from tactile_hand_ros.sweep.space import Range
from tactile_hand_ros.sweep.statistics import fraction_of, median_interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_MOST_BINS, _PER_BIN = 12, 12  # along a parameter; runs that a bin should hold
_MOST_DOTS = 1500
_MOST_MAPS = 6  # pairs of parameters that are drawn


def figures(results: Results) -> dict[str, Figure]:
    """Draw the figures of one scenario, by name; none without a parameter that is a number."""
    paths = list(results.parameters)
    if not paths or not len(results.table["outcome"]):
        return {}
    drawn = {"metrics": _metric_figure(results, paths[:4])}
    if len(paths) > 1:
        pairs = list(itertools.combinations(paths, 2))[:_MOST_MAPS]
        drawn["success"] = _success_figure(results, pairs)
    tail = f"_{results.scenario}" if results.scenario else ""
    return {name + tail: figure for name, figure in drawn.items()}


def _success_figure(results: Results, pairs: list[tuple[str, str]]) -> Figure:
    """Draw the fraction of runs that reach the goal over pairs of parameters."""
    reached = results.column(REACHED)
    bins = max(2, min(_MOST_BINS, int(math.sqrt(len(reached) / _PER_BIN))))
    across = min(3, len(pairs))
    rows = math.ceil(len(pairs) / across)
    with look():
        figure = new_figure(PAGE if across > 1 else 0.6 * PAGE, 2.4 * rows)
        panels = figure.subplots(rows, across, squeeze=False).ravel()
        for axes, pair in itertools.zip_longest(panels, pairs):
            if pair is None:
                axes.set_visible(False)
                continue
            edges: Any = [_edges(results, path, bins) for path in pair]
            x, y = (results.column(path) for path in pair)
            count, *_ = np.histogram2d(x, y, edges)
            good, *_ = np.histogram2d(x, y, edges, weights=reached)
            with np.errstate(invalid="ignore"):
                fraction = np.ma.masked_invalid(good / count).T
            mesh = axes.pcolormesh(*edges, fraction, cmap="cividis", vmin=0.0, vmax=1.0)
            _scale(axes, results, *pair)
            axes.grid(False)
        bar = figure.colorbar(mesh, ax=panels.tolist(), shrink=0.9)
        bar.set_label("fraction of runs that reach the goal")
    return figure


def _metric_figure(results: Results, paths: list[str]) -> Figure:
    """Draw success and each metric against parameters: runs, medians and their intervals."""
    known = [name for name in results.metrics if np.isfinite(results.column(name)).any()]
    names = [REACHED, *known]
    with look():
        figure = new_figure(PAGE if len(paths) > 1 else 0.6 * PAGE, 1.5 * len(names))
        panels = figure.subplots(len(names), len(paths), squeeze=False, sharey="row", sharex="col")
        for column, path in enumerate(paths):
            for row, name in enumerate(names):
                _against(panels[row, column], results, path, name)
            _scale(panels[-1, column], results, path)
        for row, name in enumerate(names):
            panels[row, 0].set_ylabel(_label(name))
    return figure


def _against(axes: Axes, results: Results, path: str, name: str) -> None:
    x, y = results.column(path), results.column(name)
    edges = _edges(results, path, max(2, min(_MOST_BINS, len(x) // _PER_BIN)))
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    points = []
    for i in range(len(edges) - 1):
        some = y[bins == i]
        is_reached = name == REACHED
        found = fraction_of(int(some.sum()), len(some)) if is_reached else median_interval(some)
        if not math.isnan(found[0]):
            points.append((np.median(x[bins == i]), *found))
    if name == REACHED:
        axes.set_ylim(-0.05, 1.05)
    else:
        step = max(1, len(x) // _MOST_DOTS)
        axes.plot(x[::step], y[::step], ".", color=FAINT, markersize=1.5, alpha=0.5)
    if points:
        at, middle, low, high = np.array(points).T
        lengths = np.maximum(0.0, [middle - low, high - middle])
        axes.errorbar(at, middle, lengths, fmt="o-", color=run_color(0), markersize=3.0)


def _edges(results: Results, path: str, bins: int) -> Array:
    """Return the edges of bins: between values where there are few of them, else evenly."""
    few = np.unique(results.column(path)).astype(float)
    if len(few) <= _MOST_BINS:
        middles = 0.5 * (few[1:] + few[:-1])
        gaps = (few[1] - few[0], few[-1] - few[-2]) if len(few) > 1 else (1.0, 1.0)
        return np.array([few[0] - 0.5 * gaps[0], *middles, few[-1] + 0.5 * gaps[1]])
    space: Any = np.geomspace if _is_log(results, path) else np.linspace
    return np.asarray(space(few[0], few[-1], bins + 1))


def _is_log(results: Results, path: str) -> bool:
    parameter = results.parameters[path]
    return isinstance(parameter, Range) and parameter.is_log


def _scale(axes: Axes, results: Results, x: str, y: str = "") -> None:
    axes.set_xlabel(x)
    if _is_log(results, x):
        axes.set_xscale("log")
    if y:
        axes.set_ylabel(y)
        if _is_log(results, y):
            axes.set_yscale("log")


def _label(name: str) -> str:
    """Return a column as people write it: its unit in brackets, in short lines."""
    words, _, unit = name.rpartition("_")
    words, unit = (words, f" [{unit}]") if unit in ("m", "rad", "N", "s") else (name, "")
    return textwrap.fill(words.replace("_", " ") + unit, 18)
