# SPDX-License-Identifier: Apache-2.0
"""Measurements as figures: real time, and cost against size."""

from __future__ import annotations

from collections.abc import Sequence
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.realtime.cases import CONDITIONS, RealtimeRun
from bench.sizes import (
    CONTROLLER,
    FINGERS,
    ONE_HAND,
    OPTIMIZER,
    PLANT,
    STEPS,
    TWO_HANDS,
    Cost,
)
from tactile_hand_ros.report.style import FAINT, PAGE, label_panel, look, new_figure, run_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_LEAST_SHARE = 1e-5
_MS = 1e3
_BINS = np.logspace(-3, 3, 61)  # ms
_ENDS = (4e-3, 1e3)  # ms


def realtime_figure(runs: Sequence[RealtimeRun]) -> Figure:
    """Draw for each rate how ticks jitter and which share of commands is older than an age."""
    with look():
        figure = new_figure(PAGE, 4.6)
        rates = sorted({run.case.rate for run in runs})
        panels = figure.subplots(2, len(rates), sharex=True, sharey="row", squeeze=False)
        for column, rate in enumerate(rates):
            some = [run for run in runs if run.case.rate == rate]
            _draw_rate(panels[0, column], panels[1, column], some)
            above, below = ascii_lowercase[column], ascii_lowercase[len(rates) + column]
            label_panel(panels[0, column], above, f"jitter, {rate:g} Hz")
            label_panel(panels[1, column], below, f"age, {rate:g} Hz")
            panels[1, column].set_xlabel("ms")
            for axes in panels[:, column]:
                axes.axvline(_MS / rate, color=FAINT, linewidth=0.8)
        panels[0, 0].set_ylabel("share of ticks in a bin")
        panels[1, 0].set_ylabel("share of commands older")
        figure.legend(
            *panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3
        )
    return figure


def _draw_rate(jitter: Axes, age: Axes, runs: Sequence[RealtimeRun]) -> None:
    for run in runs:
        style: dict[str, Any] = {
            "color": run_color(CONDITIONS.index(run.case.condition)),
            "linestyle": "--" if run.case.composed else "-",
            "label": f"{run.case.where}, {run.case.condition}",
            "linewidth": 1.0,
        }
        counts, _ = np.histogram(_MS * run.run.jitter, _BINS)
        jitter.step(_BINS[:-1], counts / max(1, counts.sum()), where="post", **style)
        ages = np.sort(_MS * run.run.ages)
        age.plot(ages, 1.0 - np.arange(len(ages)) / len(ages), **style)
    for axes in (jitter, age):
        axes.set_xscale("log")
        axes.set_xlim(*_ENDS)
    age.set_yscale("log")
    age.set_ylim(_LEAST_SHARE, 1.5)


def sizes_figure(costs: Sequence[Cost]) -> Figure:
    """Draw how the cost of each block grows with fingers, joints, hands and finer steps."""
    with look():
        figure = new_figure(PAGE, 4.4)
        panels = figure.subplots(2, 3)
        for axes, (letter, block) in zip(
            panels.flat,
            zip("abcd", (OPTIMIZER, CONTROLLER, PLANT, ONE_HAND), strict=True),
            strict=False,
        ):
            _draw_block(axes, costs, block)
            label_panel(axes, letter, block)
        _draw_hands(panels[1, 1], costs)
        label_panel(panels[1, 1], "e", "two hands to one")
        _draw_steps(panels[1, 2], costs)
        label_panel(panels[1, 2], "f", "finer steps")
        panels[0, 0].set_ylabel("µs")
        panels[1, 0].set_ylabel("µs")
        panels[0, 0].legend(title="fingers", ncols=3)
    return figure


def _of_fingers(costs: Sequence[Cost], fingers: int) -> list[Cost]:
    """Return the hands of so many fingers at the ordinary step, by their joints."""
    chosen = [c for c in costs if c.size.fingers == fingers and c.size.step == STEPS[0]]
    return sorted(chosen, key=lambda cost: cost.size.joints)


def _draw_block(axes: Axes, costs: Sequence[Cost], block: str) -> None:
    for i, fingers in enumerate(FINGERS):
        some = _of_fingers(costs, fingers)
        x = [cost.size.joints for cost in some]
        y = [cost.median(block) for cost in some]
        axes.plot(x, y, "o-", color=run_color(i), markersize=3.0, label=str(fingers))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("joints of a finger")


def _draw_hands(axes: Axes, costs: Sequence[Cost]) -> None:
    for i, fingers in enumerate(FINGERS):
        some = _of_fingers(costs, fingers)
        ratios = [cost.median(TWO_HANDS) / cost.median(ONE_HAND) for cost in some]
        x = [cost.size.joints for cost in some]
        axes.plot(x, ratios, "o-", color=run_color(i), markersize=3.0)
    axes.axhline(2.0, color=FAINT, linewidth=0.8)
    axes.set_ylim(0.0, 2.5)
    axes.set_xlabel("joints of a finger")
    axes.set_ylabel("ratio")


def _draw_steps(axes: Axes, costs: Sequence[Cost]) -> None:
    least = min(costs, key=lambda cost: (cost.size.fingers, cost.size.joints)).size
    some = [c for c in costs if (c.size.fingers, c.size.joints) == (least.fingers, least.joints)]
    some.sort(key=lambda cost: cost.size.step)
    x = [_MS * cost.size.step for cost in some]
    for i, block in enumerate((PLANT, ONE_HAND)):
        y = [cost.median(block) for cost in some]
        axes.plot(x, y, "o-", color=run_color(3 + i), markersize=3.0, label=block)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("step of the plant [ms]")
    axes.set_ylabel("µs")
    axes.legend()
