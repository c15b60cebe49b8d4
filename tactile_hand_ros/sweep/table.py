# SPDX-License-Identifier: Apache-2.0
"""Results of a study on disk: one row per run, appended as JSON lines and finally written as CSV.

A killed study continues after its last complete row. The CSV file has the same bytes for any
number of workers and any order of runs.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tactile_hand_ros
from tactile_hand_ros import files
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.sweep.engine import Point, Study, StudyError

DESCRIPTION, ROWS, TABLE = "study.json", "runs.jsonl", "runs.csv"
INDEX = "run"
"""Name of the first column."""

Table = Mapping[str, NDArray[Any]]
"""Columns by name; NaN where a number is missing."""


Watch = Callable[[int, int], None]
"""Called with the number of finished runs and that of all runs."""


def keep(study: Study, folder: Path, watch: Watch = lambda done, total: None) -> None:
    """Execute all unfinished runs and write the table of all runs.

    A row contains number, outcome, reason of a failure and seed of its run, then its parameters,
    dataclasses field by field, then the returned values.

    Args:
        study: Its runs return a mapping of columns, including `outcome`.
        folder: Output folder; may hold the results of an earlier, unfinished call.
        watch: Called after each run.

    Raises:
        StudyError: If the folder holds another study or cannot be written, or processes die.
    """
    try:
        total, finished = len(study.fractions), _begin(study, folder)
        left = [i for i in range(total) if i not in finished]
        if left:
            ensure_compiled()
        try:
            with (folder / ROWS).open("a", encoding="utf-8", buffering=1) as rows:  # line by line
                for new, (point, result) in enumerate(study.results(left), 1):
                    rows.write(json.dumps(_row(point, result)) + "\n")
                    watch(len(finished) + new, total)
        finally:
            _write_table(folder)
    except OSError as error:
        raise StudyError(
            f"the results cannot be written to {folder} ({error.strerror or error}); "
            "make room there and repeat the command: what was written before is kept."
        ) from None


def _begin(study: Study, folder: Path) -> set[int]:
    """Create the folder, or continue the study in it; return the finished runs."""
    file, rows = folder / DESCRIPTION, folder / ROWS
    content = {
        "version": tactile_hand_ros.__version__,
        "runs": study.runs,
        "seed": study.seed,
        "over": {name: str(parameter) for name, parameter in study.space.items()},
        **study.description,
    }
    text = json.dumps(content, indent=1) + "\n"
    if file.exists() or rows.exists():
        before: dict[str, Any] = {}
        with contextlib.suppress(FileNotFoundError, ValueError, TypeError):  # unlike any study
            before = dict(json.loads(file.read_text("utf-8")))
        _compare(before, json.loads(text), folder)
    folder.mkdir(parents=True, exist_ok=True)
    files.replace_text(file, text)
    kept = rows.read_text("utf-8") if rows.is_file() else ""
    whole = kept[: kept.rfind("\n") + 1]  # a kill may have cut off the last line
    if whole != kept:
        files.replace_text(rows, whole)
    return {int(row[INDEX]) for row in _rows(folder)} if kept else set()


def _row(point: Point, result: Any) -> dict[str, Any]:
    row = {INDEX: point.index, "outcome": "", "reason": "", "seed": point.seed}
    for name, value in point.values.items():
        row |= asdict(value) if is_dataclass(value) else {name: value}  # type: ignore[arg-type]
    return {**row, **result}


def _write_table(folder: Path) -> None:
    rows = _rows(folder)
    text, names = io.StringIO(), dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        texts = {n: json.dumps(c) if isinstance(c, list | dict) else c for n, c in row.items()}
        writer.writerow(texts)
    files.replace_text(folder / TABLE, text.getvalue())


def _rows(folder: Path) -> list[dict[str, Any]]:
    """Return all finished runs in the order of their numbers."""
    rows = []
    for number, line in enumerate((folder / ROWS).read_text("utf-8").splitlines(), 1):
        try:
            row = json.loads(line)
            rows.append((int(row[INDEX]), row))
        except (ValueError, TypeError, KeyError):
            raise StudyError(
                f"line {number} of {folder / ROWS} is damaged; delete it and repeat the command, "
                "which makes its run again."
            ) from None
    return [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def read_table(folder: Path) -> dict[str, NDArray[Any]]:
    """Return all finished runs of a study by column, in the order of their numbers.

    Values other than numbers and strings are JSON strings.

    Raises:
        StudyError: If the folder holds no study.
    """
    try:
        rows = _rows(folder)
    except OSError as error:
        raise StudyError(f"{folder / ROWS} cannot be read ({error.strerror}).") from None
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(cells: list[Any]) -> NDArray[Any]:
    kinds = {type(cell) for cell in cells}
    if kinds <= {bool, int, float, type(None)}:
        return np.array(cells, dtype=None if kinds in ({bool}, {int}) else float)  # NaN for None
    texts = [c if isinstance(c, str | None) else json.dumps(c) for c in cells]
    return np.array(texts, dtype=object)


def _compare(before: Mapping[str, Any], now: Mapping[str, Any], folder: Path) -> None:
    for key in now:
        if before.get(key) != now[key]:
            texts = [f"{json.dumps(each.get(key)):.80}" for each in (before, now)]
            raise StudyError(
                f"{folder} holds another study: {key} is {texts[0]} there and {texts[1]} "
                "here; choose another --out, or repeat the first command."
            )
