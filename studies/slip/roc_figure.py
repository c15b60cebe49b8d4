# SPDX-License-Identifier: Apache-2.0
"""The detector's receiver operating curve as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from studies.slip.roc import Point
from tactile_hand_ros.report.style import FAINT, PAGE, finger_color, label_panel, look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS = ("o", "s", "^")


def roc_figure(points: Sequence[Point]) -> Figure:
    """Draw detection within 10 ms, and the median delay, against false alarms."""
    with look():
        figure = new_figure(PAGE, 2.6)
        left, right = figure.subplots(1, 2)
        for i, noise in enumerate(sorted({p.noise for p in points})):
            some = [p for p in points if p.noise == noise]
            # None at all still leaves one in the time that was looked at; a logarithm needs more.
            x = [max(p.false_alarm_rate, 0.5 / p.minutes) for p in some]
            name, mark = f"{1e3 * noise:g} mN", _MARKS[i % 3] + "-"
            style = {"color": finger_color(i), "markersize": 3.5, "label": name}
            left.plot(x, [p.in_time / max(p.slips, 1) for p in some], mark, **style)
            right.plot([p.threshold for p in some], [1e3 * p.delay for p in some], mark, **style)
        left.set_xscale("log")
        left.set_ylim(0.0, 1.0)
        left.set_xlabel("false alarms per minute (leftmost: none)")
        left.set_ylabel("alarm within 10 ms")
        label_panel(left, "a", "receiver operating curve")
        right.axhline(10.0, color=FAINT, linewidth=0.8)
        right.set_xlabel("threshold of evidence")
        right.set_ylabel("median delay [ms]")
        right.set_ylim(bottom=0.0)
        label_panel(right, "b", "delay of detection")
        left.legend(title="force noise")
    return figure
