# SPDX-License-Identifier: Apache-2.0
"""Results as tables for the terminal and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tactile_hand_ros.extras import optional
from tactile_hand_ros.run.assumptions import Assumption
from tactile_hand_ros.run.metrics import Metrics
from tactile_hand_ros.run.recording import BagMetrics

if TYPE_CHECKING:
    from rich.table import Table

_NOTHING = 1e-9  # m or rad; rounding errors, no motion
_LEAST = 1e-6  # m or rad; the size of smaller values does not matter
Rows = Sequence[Sequence[str]]


def metrics_rows(m: Metrics) -> list[list[str]]:
    """Return the metrics of a run as text: name and value."""
    held = not m.is_dropped
    return [
        ["simulated time", f"{m.simulated_time_s:g} s in {m.ticks} ticks"],
        *([] if held else [["object", f"dropped at {m.dropped_at_s:.3f} s"]]),
        *(_held_rows(m) if held else []),
        *([["link inside the object", m.link_note]] if m.link_inside else []),
        ["peak joint rate", number(m.peak_joint_rate_rad_per_s, "rad/s")],
        *_contact_rows(m),
    ]


def _held_rows(m: Metrics) -> list[list[str]]:
    """Return the final metrics that exist only if the object is still in the hand."""
    rows = [
        ["final position error", milli(m.final_position_error_m, "m")],
        ["final rotation error", milli(m.final_rotation_error_rad, "rad")],
        ["settling time", number(m.settling_time_s, "s")],
        ["k_f", number(m.final_grasp_force_N, "N")],
        ["sum of f_n", _with_error(m.normal_force_sum_N, m.normal_force_sum_relative_error)],
    ]
    for name, force in m.final_normal_forces_N.items():
        expected = m.optimal_normal_forces_N[name]
        rows.append([f"f_n of {name}", f"{number(force, 'N')}  (k_f f*_n {number(expected, 'N')})"])
    return rows


def _contact_rows(m: Metrics) -> list[list[str]]:
    final, largest = m.final_required_friction, m.max_required_friction
    rows = [
        [f"beta of {name}, final / largest", f"{number(beta)} / {number(largest[name])}"]
        for name, beta in final.items()
    ]
    lost = "" if math.isnan(m.first_contact_loss_s) else f", first at {m.first_contact_loss_s:g} s"
    rows.append(["ticks without a contact", f"{m.contacts_lost_ticks}{lost}"])
    if not math.isnan(m.max_object_rotation_in_grasp_rad):
        moved = milli(m.max_object_displacement_in_grasp_m, "m")
        turned = number(m.max_object_rotation_in_grasp_rad, "rad")
        rows.append(["largest motion of the object in the grasp", f"{moved}, {turned}"])
    if not math.isnan(m.max_slip_distance_m):
        rows.append(["longest slip", milli(m.max_slip_distance_m, "m")])
    times = "" if m.slip_count is None else f"{m.slip_count}, "
    rows.append(["slips, detected", f"{times}{m.slip_alarm_count}"])
    if m.goal_reached is not None:
        rows.append(["goal", "reached" if m.goal_reached else "not reached"])
    return rows


ASSUMPTION_COLUMNS = ("", "assumption", "margin", "worst", "limit", "held")


def assumption_rows(lines: Sequence[Assumption]) -> list[list[str]]:
    """Return assumptions as text."""
    return [[a.name, a.meaning, a.margin, number(a.worst), _limit(a), _held(a)] for a in lines]


def _limit(a: Assumption) -> str:
    return "none known" if math.isnan(a.limit) else f"{'<' if a.below else '>'} {a.limit:g}"


def _held(a: Assumption) -> str:
    """Describe how long an assumption held and when it did not."""
    if math.isnan(a.held_fraction):
        return "not judged"
    if not a.broken:
        return "throughout"
    times = ", ".join(f"{start:.2f} to {end:.2f} s" for start, end in a.broken[:3])
    more = f" and {len(a.broken) - 3} more" if len(a.broken) > 3 else ""
    return f"{100.0 * a.held_fraction:.1f} %, violated from {times}{more}"


def bag_rows(b: BagMetrics) -> list[list[str]]:
    """Return completeness and timing of a bag as text: name and value."""
    short = {t: c for t, c in b.topics.items() if c.complete is False}
    latencies = b.command_latency_median_s, b.command_latency_p99_s, b.command_latency_max_s
    listed = " / ".join(number(1e3 * value, "ms") for value in latencies)
    rows = [
        ["messages", str(b.messages)],
        ["speed", number(b.ticks_per_second, "ticks/s")],
        ["command latency, median / p99 / longest", listed],
        ["ticks sent again", str(b.repeated_ticks)],
        ["recording", "complete" if b.complete else "incomplete"],
    ]
    rows += [[f"  {topic}", f"{count.ticks} ticks"] for topic, count in short.items()]
    return rows + [[f"  {topic}", "absent"] for topic in b.absent]


def rich_table(title: str, columns: Sequence[str], rows: Rows = ()) -> Table:
    """Return a table for the terminal; raise MissingLibraryError without rich."""
    rich = optional("rich.table", "Tables in the terminal")
    table: Table = rich.Table(
        title=title, title_justify="left", title_style="bold", show_header=any(columns)
    )
    for column in columns:
        table.add_column(column, no_wrap=column == "verdict", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def markdown(columns: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(
        "| " + " | ".join(c.replace("|", "\\|") for c in line) + " |\n" for line in lines
    )


def number(value: float, unit: str = "") -> str:
    """Return a number with its unit, ``unknown`` for NaN."""
    if math.isnan(value):
        return "unknown"
    return f"{value:.4g} {unit}".rstrip()


def milli(value: float, unit: str) -> str:
    """Return a length [m] or angle [rad] in thousandths, without insignificant digits."""
    if math.isnan(value):
        return "unknown"
    if abs(value) < _NOTHING:
        return f"0 m{unit}"
    return f"< 0.001 m{unit}" if abs(value) < _LEAST else number(1e3 * value, f"m{unit}")


def _with_error(value: float, error: float) -> str:
    off = "" if math.isnan(error) else f"  ({100 * error:.2g} % off k_f)"
    return ("unknown" if math.isnan(value) else f"{value:.6g} N") + off
