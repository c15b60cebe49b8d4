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
from tactile_hand_ros.sweep.results import Results
from tactile_hand_ros.sweep.space import Range
from tactile_hand_ros.sweep.statistics import fraction_of, median_interval
from tactile_hand_ros.sweep.table import REACHED

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
    drawn = {"metrics": metric_figure(results, paths[:4])}
    if len(paths) > 1:
        pairs = list(itertools.combinations(paths, 2))[:_MOST_MAPS]
        drawn["success"] = success_figure(results, pairs)
    tail = f"_{results.scenario}" if results.scenario else ""
    return {name + tail: figure for name, figure in drawn.items()}


def success_figure(results: Results, pairs: list[tuple[str, str]]) -> Figure:
    """Draw the fraction of runs that reach the goal over pairs of parameters, with contours."""
    reached = results.column(REACHED)
    across = min(3, len(pairs))
    rows = math.ceil(len(pairs) / across)
    with look():
        figure = new_figure(PAGE if across > 1 else 0.6 * PAGE, 2.4 * rows)
        panels = np.atleast_1d(figure.subplots(rows, across, squeeze=False)).ravel()
        for axes, (x, y) in zip(panels, pairs, strict=False):
            mesh = _map(axes, results, x, y, reached)
        for axes in panels[len(pairs) :]:
            axes.set_visible(False)
        bar = figure.colorbar(mesh, ax=panels.tolist(), shrink=0.9)
        bar.set_label("fraction of runs that reach the goal")
    return figure


def _map(axes: Axes, results: Results, x: str, y: str, reached: Array) -> Any:
    bins = max(2, min(_MOST_BINS, int(math.sqrt(len(reached) / _PER_BIN))))
    columns = results.column(x), results.column(y)
    edges = [_edges(results, path, v, bins) for path, v in zip((x, y), columns, strict=True)]
    count, *_ = np.histogram2d(*columns, edges)
    good, *_ = np.histogram2d(*columns, edges, weights=reached)
    with np.errstate(invalid="ignore"):
        fraction = np.ma.masked_invalid(good / count).T
    mesh = axes.pcolormesh(*edges, fraction, cmap="cividis", vmin=0.0, vmax=1.0)
    _scale(axes, results, x, y)
    centers = [_centers(results, p, e) for p, e in zip((x, y), edges, strict=True)]
    if min(fraction.shape) > 1 and np.ma.min(fraction) < 0.9:
        lines = axes.contour(*centers, fraction, levels=[0.5, 0.9], colors=["white", "white"])
        axes.clabel(lines, fmt=lambda level: f"{100 * level:.0f} %", fontsize=6.0)
    axes.grid(False)
    return mesh


def _edges(results: Results, path: str, values: Array, bins: int) -> Array:
    """Return the edges of bins: between values where there are few of them, else evenly."""
    few = np.unique(values)
    if len(few) <= _MOST_BINS:
        middles = 0.5 * (few[1:] + few[:-1])
        first = few[0] - (middles[0] - few[0] if len(few) > 1 else 0.5)
        last = few[-1] + (few[-1] - middles[-1] if len(few) > 1 else 0.5)
        return np.concatenate([[first], middles, [last]])
    if _is_log(results, path):
        return np.asarray(np.geomspace(few[0], few[-1], bins + 1))
    return np.linspace(few[0], few[-1], bins + 1)


def _centers(results: Results, path: str, edges: Array) -> Array:
    if _is_log(results, path) and edges[0] > 0.0:
        return np.asarray(np.sqrt(edges[1:] * edges[:-1]))
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def metric_figure(results: Results, paths: list[str]) -> Figure:
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
    edges = _edges(results, path, x, max(2, min(_MOST_BINS, len(x) // _PER_BIN)))
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    points = []
    for i, center in enumerate(_centers(results, path, edges)):
        inside = y[bins == i]
        found = (
            fraction_of(int(inside.sum()), len(inside))
            if name == REACHED
            else median_interval(inside)
        )
        if not math.isnan(found[0]):
            points.append((center, found[0], found[0] - found[1], found[2] - found[0]))
    if name != REACHED:
        step = max(1, len(x) // _MOST_DOTS)
        axes.plot(x[::step], y[::step], ".", color=FAINT, markersize=1.5, alpha=0.5)
    if points:
        at, middle, down, up = np.array(points).T
        lengths = np.maximum(0.0, [down, up])
        axes.errorbar(at, middle, lengths, fmt="o-", color=run_color(0), markersize=3.0)
    if name == REACHED:
        axes.set_ylim(-0.05, 1.05)
    elif (known := y[np.isfinite(y)]).size and known.min() > 0.0 and known.max() > 50 * known.min():
        axes.set_yscale("log")


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
