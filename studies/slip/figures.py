# SPDX-License-Identifier: Apache-2.0
"""Figures of the slip study."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studies.slip.cases import EVENTS
from studies.slip.outcomes import SlipOutcome
from studies.slip.study import Study
from tactile_hand_ros.report.style import (
    COLUMN,
    FAINT,
    PAGE,
    finger_color,
    label_panel,
    look,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NOISES = ((0.0, 0.005), (0.005, 0.012), (0.012, 1.0))  # N
_MARKS = ("o", "s", "^")
_LONGEST = 40.0  # ms that are drawn


def figures(study: Study) -> dict[str, Figure]:
    """Draw all figures of a study, by name."""
    return {"study_detection": detection_figure(study), "study_slip": slip_figure(study)}


def detection_figure(study: Study) -> Figure:
    """Draw how many slips are found, and answered, within a time; those never found stay out."""
    with look():
        figure = new_figure(PAGE, 2.4)
        left, right = figure.subplots(1, 2, sharey=True)
        _distributions(left, study, lambda o: o.detection)
        label_panel(left, "a", "from onset to alarm")
        _goal(left, 10.0)
        left.set_ylabel("share of slips")
        left.legend(loc="lower right", title="force noise")
        _distributions(right, study, lambda o: o.reaction)
        label_panel(right, "b", "from onset to rising squeeze")
        _goal(right, 20.0)
    return figure


def _distributions(axes: Axes, study: Study, of: Callable[[SlipOutcome], float]) -> None:
    for i, (low, high) in enumerate(_NOISES):
        runs = [o for o in _slipped(study.outcomes) if low <= o.case.noise < high]
        values = np.sort([1e3 * of(o) for o in runs])
        if not len(values):
            continue
        shares = np.arange(1, len(values) + 1) / len(values)
        name = f"{1e3 * low:g} to {1e3 * high:g} mN" if i < 2 else f"over {1e3 * low:g} mN"
        known = np.isfinite(values)
        # To the edge, so that what was never found shows as what is missing there.
        times = np.append(values[known], _LONGEST)
        found = np.append(shares[known], shares[known][-1:] if known.any() else 0.0)
        axes.step(times, found, where="post", color=finger_color(i), label=name)
    axes.set_xlim(-5.0, _LONGEST)
    axes.set_ylim(0.0, 1.0)
    axes.set_xlabel("time [ms]")


def slip_figure(study: Study) -> Figure:
    """Draw how far contacts slid against how much more squeeze the event asked for."""
    with look():
        figure = new_figure(COLUMN, 2.6)
        axes = figure.subplots()
        for i, event in enumerate(EVENTS):
            runs = [o for o in _slipped(study.outcomes) if o.case.event == event and o.survivable]
            axes.scatter(
                [o.excess for o in runs],
                [1e3 * o.slip for o in runs],
                s=7.0,
                marker=_MARKS[i],
                color=finger_color(i),
                alpha=0.6,
                linewidths=0.0,
                label={"friction": "friction falls", "step": "pull at once"}.get(event, "ramp"),
            )
        axes.axhline(1.0, color=FAINT, linewidth=0.8)
        axes.set_yscale("log")
        axes.set_ylim(1e-3, 300.0)
        axes.set_xlabel("least squeeze after the event / squeeze before it")
        axes.set_ylabel("slip distance [mm]")
        axes.legend()
    return figure


def _goal(axes: Axes, value: float) -> None:
    axes.axvline(value, color=FAINT, linewidth=0.8)


def _slipped(outcomes: Sequence[SlipOutcome]) -> list[SlipOutcome]:
    return [o for o in outcomes if not math.isnan(o.onset)]
