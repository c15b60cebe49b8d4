# SPDX-License-Identifier: Apache-2.0
"""The words and numbers of the page: headline, tables, assumptions, settings, notes."""

from __future__ import annotations

import math
from typing import Any

from tactile_hand_ros.errors import counted
from tactile_hand_ros.report import tables
from tactile_hand_ros.run.metrics import peak
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP

_VERSION = "version_"


def passed(run: RunData) -> bool | None:
    """Return whether the object is held and the goal reached; None if no goal applies."""
    return False if run.metrics.is_dropped else run.metrics.goal_reached


def tiles(run: RunData) -> list[dict[str, Any]]:
    """Return the headline: a few numbers, each with a label and a verdict."""
    m, bag = run.metrics, run.bag_metrics
    if m.is_dropped:
        dropped = _tile("object dropped", m.dropped_at_s, "s", "fewer than two fingers touch it")
        found = [{**dropped, "passed": False}]
    else:
        found = [
            _limited(run, "position error", m.final_position_error_m, "m", "position_error"),
            _limited(run, "orientation error", m.final_rotation_error_rad, "rad", "rotation_error"),
        ]
        settled = _tile("settled after", m.settling_time_s, "s", "both errors inside")
        found += [] if run.steered else [settled]
    highest = tables.number(peak(run.record.grasp_force), "N")
    found += [
        _tile("grasp force k_f", m.final_grasp_force_N, "N", f"peak {highest}"),
        _slips(run),
    ]
    if bag is not None:
        speed = _tile("speed", bag.ticks_per_second, "ticks/s", f"{len(run.record)} ticks")
        value, unit, note = str(bag.messages), "", "messages"
        if run.lost_messages is not None:
            value, unit = str(run.lost_messages), "lost"
            note = f"of {counted(bag.messages, 'message')}"
        found += [speed, {"label": "recorded", "value": value, "unit": unit, "note": note}]
    return found


def _slips(run: RunData) -> dict[str, Any]:
    """Return slip distance and count with ground truth, otherwise the number of alarms."""
    m = run.metrics
    note = f"{m.slip_alarm_count} detected"
    if m.slip_count is None:
        return _tile("slips", m.slip_alarm_count, "", note)
    note = f"{counted(m.slip_count, 'slip')}, {note}"
    return _limited(run, "longest slip", m.max_slip_distance_m, "m", "slip_distance", note)


def _limited(
    run: RunData, label: str, value: float, unit: str, goal: str, note: str = ""
) -> dict[str, Any]:
    """Return a tile of a length or angle that the goal may limit."""
    number, _, milli = tables.milli(float(f"{value:.3g}"), unit).rpartition(" ")
    tile = {"label": label, "value": number or milli, "unit": milli if number else ""}
    limit = UNLIMITED_SLIP
    if run.scenario is not None and not run.steered:
        limit = getattr(run.scenario.goal, goal)
    if limit >= UNLIMITED_SLIP:
        return {**tile, "note": note or "at the end"}
    note = ", ".join(filter(None, [f"goal {1e3 * limit:g} m{unit}", note]))
    return {**tile, "note": note, "passed": value <= limit}


def _tile(label: str, value: float, unit: str, note: str) -> dict[str, Any]:
    is_known = not math.isnan(value)
    shown, unit = (f"{value:.3g}", unit) if is_known else ("unknown", "")
    return {"label": label, "value": shown, "unit": unit, "note": note}


def all_tables(run: RunData) -> list[dict[str, Any]]:
    """Return the tables below the plots."""
    noted = run.custom_data
    versions = [[k.removeprefix(_VERSION), v] for k, v in noted.items() if k.startswith(_VERSION)]
    if run.scenario is not None:
        versions.append(["seed", str(run.scenario.seed)])
    found = [
        {"title": "Metrics", "rows": tables.metrics_rows(run.metrics)},
        {"title": "Recording", "rows": _recording_rows(run)},
        {"title": "Versions and seed", "rows": versions},
    ]
    return [table for table in found if table["rows"]]


def _recording_rows(run: RunData) -> list[list[str]]:
    if run.bag_metrics is None:
        return []
    lost = run.lost_messages
    first, *rest = tables.bag_rows(run.bag_metrics)
    return [first, ["messages lost", "not recorded" if lost is None else str(lost)], *rest]


def assumptions(run: RunData) -> list[dict[str, Any]]:
    """Return the assumptions with their values as text."""
    heads = ("name", "meaning", "margin", "worst", "limit")
    return [
        {
            **dict(zip(heads, tables.assumption_rows([line])[0], strict=False)),
            "held": None if math.isnan(line.held_fraction) else line.held_fraction,
            "broken": [list(interval) for interval in line.broken],
        }
        for line in run.assumptions
    ]


def notes(run: RunData) -> list[str]:
    """Return the warnings that a reader needs before trusting the page."""
    found = []
    if run.scenario_problem:
        found.append(
            "The scenario in the bag does not fit this version of the package: goal, disturbances "
            "and assumptions are omitted."
        )
    elif run.scenario is None:
        found.append("The scenario is unknown: goal, object and assumptions are omitted.")
    if run.assumptions_problem:
        found.append(run.assumptions_problem)
    if run.bag_metrics is not None and not run.bag_metrics.complete:
        found.append("The recording is incomplete; gaps in the plots are ticks without a message.")
    return found
