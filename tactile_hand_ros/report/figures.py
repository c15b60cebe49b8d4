# SPDX-License-Identifier: Apache-2.0
"""The paper's Fig. 3 (motion and normal forces) and Fig. 4 (required friction), from records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.extras import optional
from tactile_hand_ros.report.style import (
    AXES,
    INK,
    JOINT_LINES,
    PAGE,
    finger_color,
    look,
    new_figure,
    pretty,
)
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.metrics import START_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from tactile_hand_ros.hand.hand import Hand

LineStyle = str | tuple[float, Sequence[float]]

_DASHED: LineStyle = (0, (4, 3))
_TARGET: dict[str, Any] = {"color": INK, "linestyle": _DASHED, "linewidth": 0.8, "zorder": 3}
_LINES: tuple[LineStyle, ...] = ("-", (0, (3, 1.5)), (0, (1, 1.2)), (0, (5, 1, 1, 1)))


def motion_figure(record: Record, hand: Hand | None = None) -> Figure:
    """Draw Fig. 3: joint rates, position, orientation error and normal forces over time."""
    with look():
        figure = new_figure(PAGE, 4.2)
        axes = figure.subplots(2, 2, sharex=True)
        draw_rates(axes[0, 0], record, hand)
        axes[0, 0].set_title("(a) joint rates")
        draw_position(axes[0, 1], record)
        axes[0, 1].set_title("(b) centroid of the contacts")
        draw_rotation_error(axes[1, 0], record)
        axes[1, 0].set_title("(c) orientation error")
        draw_normal_forces(axes[1, 1], record)
        axes[1, 1].set_title("(d) normal forces")
        for panel in axes[1]:
            panel.set_xlabel("time [s]")
        if len(record) > 1:
            axes[0, 0].set_xlim(record.times[0], record.times[-1])
        handles = _motion_handles(record, hand)
        figure.legend(
            handles=handles, loc="outside upper center", ncols=len(handles), columnspacing=1.2
        )
    return figure


def draw_rates(axes: Axes, record: Record, hand: Hand | None = None) -> None:
    """Draw all joint rates, one color per finger and one line style per joint.

    Without a hand, the joints count as those of one finger after the other.
    """
    per_finger, drawn = _joints_per_finger(record), Counter[int]()
    for j in range(len(record.joint_names)):
        finger = j // per_finger if hand is None else int(hand.moves[:, j].argmax())
        style = JOINT_LINES[drawn[finger] % len(JOINT_LINES)]
        color, drawn[finger] = finger_color(finger), drawn[finger] + 1
        axes.plot(record.times, record.rates[:, j], color=color, linestyle=style, linewidth=1.0)
    axes.set_ylabel(r"$\dot{\theta}$ [rad/s]")


def draw_position(axes: Axes, record: Record) -> None:
    """Draw the contact centroid as estimated by the hand, and p_d dashed."""
    for i in range(3):
        axes.plot(record.times, record.auxiliary_position[:, i], color=AXES[i])
        axes.plot(record.times, record.desired_position[:, i], **_TARGET)
    axes.set_ylabel(r"$\bar{p}_c$ and $p_d$ [m]")


def draw_rotation_error(axes: Axes, record: Record) -> None:
    """Draw the components of r_d."""
    error = derived.rotation_error(record)
    axes.axhline(0.0, **_TARGET)
    for i in range(3):
        axes.plot(record.times, error[:, i], color=AXES[i])
    axes.set_ylabel(r"$r_d$ [rad]")


def draw_normal_forces(axes: Axes, record: Record) -> None:
    """Draw f_n of each finger, and k_f f*_n dashed."""
    normal = derived.contact_forces(record)[:, :, 1]
    expected = derived.expected_normal_forces(record)
    for i in range(len(record.finger_names)):
        axes.plot(record.times[1:], normal[1:, i], color=finger_color(i))
        axes.plot(record.times, expected[:, i], **_TARGET)
    axes.set_ylabel(r"$f_n$ and $k_f f^*_n$ [N]")
    axes.set_ylim(bottom=0.0)


def friction_figure(records: Mapping[str, Record]) -> Figure:
    """Draw Fig. 4: the friction coefficient that each contact needs, for one or more runs.

    `records` is keyed by name in the legend; the first run is drawn strongest.
    """
    first = next(iter(records.values()))
    with look():
        figure = new_figure(PAGE, 2.2)
        count = max(1, len(first.finger_names))
        panels = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)
        for i, name in enumerate(first.finger_names):
            _draw_friction(panels[0, i], records, i)
            panels[0, i].set_title(f"({'abcdefgh'[i % 8]}) {pretty(name)}")
            panels[0, i].set_xlabel("time [s]")
        panels[0, 0].set_ylabel(r"$\beta = \sqrt{f_x^2 + f_z^2}\,/\,f_n$")
        panels[0, 0].set_ylim(bottom=0.0)
        if len(first) > 1:
            panels[0, 0].set_xlim(first.times[0], first.times[-1])
        handles = [_handle(INK, line, label) for line, label in zip(_LINES, records, strict=False)]
        if len(records) > 1:
            figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _draw_friction(axes: Axes, records: Mapping[str, Record], finger: int) -> None:
    for number, record in enumerate(records.values()):
        shown = record.times >= START_S
        axes.plot(
            record.times[shown],
            derived.required_friction(record)[shown, finger],
            color=finger_color(finger),
            linestyle=_LINES[number % len(_LINES)],
            linewidth=1.5 if number == 0 else 1.1,
        )


def _joints_per_finger(record: Record) -> int:
    return max(1, len(record.joint_names) // max(1, len(record.finger_names)))


def _motion_handles(record: Record, hand: Hand | None) -> list[Line2D]:
    """Return the legend of Fig. 3: fingers, their joints, axes and target."""
    fingers = [_handle(finger_color(i), "-", pretty(n)) for i, n in enumerate(record.finger_names)]
    most = _joints_per_finger(record) if hand is None else int(hand.moves.sum(axis=1).max())
    lines = JOINT_LINES[:most]
    joints = [_handle(INK, line, f"joint {j + 1}") for j, line in enumerate(lines)]
    axes = [_handle(AXES[i], "-", f"${name}$") for i, name in enumerate("xyz")]
    return [*fingers, *joints, *axes, _handle(INK, _DASHED, "target", 0.8)]


def _handle(color: str, line: LineStyle, label: str, width: float = 1.2) -> Line2D:
    """Return a line for a legend; the plot need not contain it."""
    made: Line2D = optional("matplotlib.lines", "Drawing").Line2D(
        [], [], color=color, linestyle=line, label=label, linewidth=width
    )
    return made
