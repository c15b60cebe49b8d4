# SPDX-License-Identifier: Apache-2.0
"""A run as one document for the page: arrays, events and tables."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import known_part
from tactile_hand_ros.report import facts, model
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.derived import gaps
from tactile_hand_ros.run.events import Event
from tactile_hand_ros.run.result import RunData

Rows = NDArray[np.int64]

MAX_BYTES = 2_900_000
"""Maximum size of a page's arrays before base64, so that the page stays below 5 MB."""
MAX_EVENTS = 400
_FREQUENT = ("slip", "detection", "reaction", "contact_lost", "contact_made")


def run_document(run: RunData, *, room: int = MAX_BYTES) -> dict[str, Any]:
    """Return the content of the page as plain data for JSON.

    All ticks are shown if they fit into `room` bytes before base64; see `shown` for longer runs.
    """
    record = run.record
    (hand, unknown), (solid, missing) = model.hand(run), model.solid(run)
    plots = plot_columns(run)
    columns = plots | scene_columns(record)
    per_tick = sum(4 * each[:1].size for each in columns.values())
    rows = _rows(run, room // per_tick)
    around = [pair for pair in gaps(record) if pair[0]]
    rows = np.union1d(rows, [row for pair in around for row in pair]).astype(np.int64)
    broken, breaking = [first for first, _ in around], {*plots} - {"time"}
    return {
        "name": run.name,
        "gaps": [[float(record.times[row]) for row in pair] for pair in around],
        "description": run.scenario.description if run.scenario else "",
        "recorded": _date(run),
        "headline": run.headline,
        "passed": facts.passed(run),
        "shown": len(rows),
        "ticks": len(record),
        "fingers": model.fingers(record.finger_names),
        "joints": model.joints(record.joint_names, record.finger_names, hand),
        "columns": {
            # 24 bits are too few for the time of a long run.
            name: pack(
                _shown(values, rows, broken if name in breaking else []),
                "f8" if name == "time" else "f4",
            )
            for name, values in columns.items()
        },
        "events": [asdict(event) for event in _events(run)],
        "hand": hand,
        "object": solid,
        "assumptions": facts.assumptions(run),
        "tiles": facts.tiles(run),
        "tables": facts.all_tables(run),
        "scenario": run.scenario_text,
        "notes": [*facts.notes(run), *filter(None, (unknown, missing))],
    }


def _shown(values: Array, rows: Rows, broken: Sequence[int]) -> Array:
    """Return rows of an array, with NaN at the start of a gap, so that its line is interrupted."""
    found: Array = values[rows]
    if len(broken):
        found = found.copy()
        found[np.searchsorted(rows, broken)] = np.nan
    return found


def plot_columns(run: RunData) -> dict[str, Array]:
    """Return the arrays of the plots by name, one row per tick.

    ``time`` in s, ``rates`` in rad/s, ``position_error`` in m, ``rotation_error`` (|r_d|) in rad,
    ``force`` in N in contact frames, ``expected`` (k_f f*_n) in N, ``beta`` (f_t / f_n),
    ``friction`` (estimated mu), ``grip`` (state of each contact), ``grasp_force`` (k_f) in N and
    ``latency`` in s.
    """
    record = run.record
    position_error, rotation_error = derived.pose_errors(record, run.metrics.dropped_at_s)
    return {
        "time": record.times,
        "rates": record.rates,
        "position_error": position_error,
        "rotation_error": rotation_error,
        "force": known_part(derived.contact_forces(record)),
        "expected": derived.expected_normal_forces(record),
        "beta": derived.required_friction(record),
        "friction": record.friction,
        "grip": record.grip,
        "grasp_force": record.grasp_force,
        "latency": run.latencies,
    }


def scene_columns(record: Record) -> dict[str, Array]:
    """Return the arrays of the 3D view by name, one row per tick, as in the record."""
    names = (
        *("theta", "contact_positions", "contact_quaternions"),
        *("auxiliary_position", "auxiliary_quaternion"),
        *("desired_position", "desired_quaternion", "object_position", "object_quaternion"),
    )
    return {name: getattr(record, name) for name in names}


def _events(run: RunData) -> list[Event]:
    """Return the events to show; of more than `MAX_EVENTS`, the first of the frequent kinds."""
    first = sorted(run.events, key=lambda event: event.kind in _FREQUENT)[:MAX_EVENTS]
    return sorted(first, key=lambda event: event.time)


def _rows(run: RunData, limit: int) -> Rows:
    record = run.record
    at_events = np.searchsorted(record.times, [event.time for event in _events(run)])
    of_parts = (
        np.abs(record.rates),
        derived.contact_forces(record)[:, :, 1],
        derived.required_friction(record),
    )
    # A bag may lack a finger, and a finger may not touch.
    highest = [np.fmax.reduce(each, axis=1, initial=np.nan) for each in of_parts]
    signals = [*highest, record.grasp_force, run.latencies]
    return shown(len(record), limit, signals, at_events.clip(0, len(record) - 1))


def _date(run: RunData) -> str:
    """Return when the run was recorded, UTC."""
    if run.start_time is None:
        return ""
    start = datetime.datetime.fromtimestamp(1e-9 * run.start_time, datetime.timezone.utc)
    return start.strftime("%Y-%m-%d %H:%M UTC")


def shown(count: int, limit: int, signals: Sequence[Array], always: Rows) -> Rows:
    """Choose the ticks to show of `count`, in ascending order; all of them up to `limit`.

    Beyond that, keep about `limit`: those in `always`, evenly spaced ones, and for each of many
    equal pieces the ticks at which a signal, of shape (count,), is largest and smallest, so that
    every peak stays visible.
    """
    if count <= limit:
        return np.arange(count)
    peaks: list[int] = []
    for piece in np.array_split(np.arange(count), max(1, limit // (3 * len(signals)))):
        for signal in signals:
            known = piece[~np.isnan(signal[piece])]
            if len(known):
                peaks += [known[signal[known].argmin()], known[signal[known].argmax()]]
    even = np.linspace(0, count - 1, max(2, limit - len(peaks)))
    return np.unique(np.concatenate([even, always, peaks]).astype(np.int64))


def pack(array: NDArray[Any], code: str) -> dict[str, Any]:
    """Return an array of any shape as plain data for JSON; `code` is ``f4`` or ``f8``."""
    data = np.ascontiguousarray(array, dtype="<" + code).tobytes()
    return {
        "type": code,
        "shape": list(array.shape),
        "data": base64.b64encode(data).decode("ascii"),
    }
