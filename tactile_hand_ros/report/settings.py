# SPDX-License-Identifier: Apache-2.0
"""The settings in which recorded runs differ, and what to call the runs by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tactile_hand_ros.report import facts
from tactile_hand_ros.run.run import Run

_NOT_SET = "not set"
_NAMED = 2  # settings in the label of a run
_LONGEST = 60  # characters of a value in a table
_WORDS = ("name", "description")
_PLACES = ("manipulation_controller.law.folder",)  # where a file lies changes nothing


def differing(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row for each setting that is not the same in all runs: its key, and each value."""
    flat = [_flat(facts.loose_scenario(run)) for run in runs]
    keys = dict.fromkeys(key for each in flat for key in each)
    rows = [[key, *(each.get(key, _NOT_SET) for each in flat)] for key in keys]
    return [row for row in rows if len(set(row[1:])) > 1]


def labels(runs: Sequence[Run]) -> list[str]:
    """Return what to call each run: its scenario, with settings where another has the same name.

    Runs that do not differ in any setting are named by their folders.
    """
    names = [facts.name(run) for run in runs]
    if len(set(names)) == len(names):
        return names
    rows = differing(runs)
    found = []
    for column, run in enumerate(runs, 1):
        parts = [f"{row[0].rpartition('.')[2]}={row[column]}" for row in rows[:_NAMED]]
        more = [f"{len(rows) - _NAMED} more"] if len(rows) > _NAMED else []
        told = ", ".join([*parts, *more]) or run.path.resolve().name
        found.append(f"{names[column - 1]} ({told})")
    return found


def _flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return nested settings by dotted key, as text, without names and descriptions."""
    found: dict[str, str] = {}
    for key, value in data.items():
        if (not prefix and key in _WORDS) or prefix + key in _PLACES:
            continue
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            text = "" if value is None else str(value)
            found[prefix + key] = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    return found
