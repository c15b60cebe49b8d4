# SPDX-License-Identifier: Apache-2.0
"""Results of a study on disk: one row a run, kept as they come, in the end Parquet and CSV.

Rows are appended to a file of JSON lines, so that a study that is killed continues where it was.
From it the tables are made, the same bytes for any number of workers and any order of runs.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tactile_hand_ros
from tactile_hand_ros import files
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.errors import counted
from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.engine import Point, Study, StudyError

DESCRIPTION, ROWS, TABLE, TEXT = "study.json", "runs.jsonl", "runs.parquet", "runs.csv"
INDEX = "run"
"""Name of the first column."""

Table = Mapping[str, NDArray[Any]]
"""Columns by name; NaN where a number is missing."""


@dataclass
class Tally:
    """How far a study is.

    Attributes:
        total: Number of runs.
        before: Runs that were done before it began.
        outcomes: How often each outcome came since.
    """

    total: int
    before: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)

    @property
    def done(self) -> int:
        """Number of finished runs."""
        return self.before + self.outcomes.total()

    def __str__(self) -> str:
        """Return how many are done, and what came of those that were made now."""
        came = "".join(f", {count} {outcome}" for outcome, count in self.outcomes.items())
        return f"{self.done} of {counted(self.total, 'run')}{came}"


def keep(
    study: Study,
    folder: Path,
    description: Mapping[str, Any],
    watch: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Make all runs that are not done yet and write the tables of all that are.

    A row has number, outcome, reason of a failure and seed of its run, then its parameters,
    those that are dataclasses field by field, then what the run returned.

    Args:
        study: Its runs return a mapping of columns, `outcome` among them.
        folder: Where results go; holds those of an earlier, unfinished call.
        description: Of the study, plain data; a folder holds one study.
        watch: Called after each run.

    Raises:
        MissingLibraryError: If pyarrow is not installed.
        StudyError: If the folder holds another study or cannot be written, or processes die.
    """
    optional("pyarrow", "A study's table")
    total = len(study.fractions)
    version = tactile_hand_ros.__version__
    done = _begin(folder, {**description, "version": version})
    tally = Tally(total, len(done))
    if tally.before == total and (folder / TABLE).is_file():
        return tally
    ensure_compiled()
    with _writing(folder):
        rows = (folder / ROWS).open("a", encoding="utf-8", buffering=1)  # each line at once
    try:
        with rows:
            for point, result in study.results(i for i in range(total) if i not in done):
                row = _row(point, result)
                with _writing(folder):
                    rows.write(json.dumps(row) + "\n")
                tally.outcomes[row["outcome"]] += 1
                watch(tally)
    finally:
        _write_tables(folder)
    return tally


def _begin(folder: Path, description: Mapping[str, Any]) -> set[int]:
    """Create the folder, or continue the study in it; return the runs that are done."""
    file, rows = folder / DESCRIPTION, folder / ROWS
    if file.exists():
        _compare(read_description(folder), json.loads(json.dumps(description)), folder)
    with _writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files.replace_text(file, json.dumps(description, indent=1) + "\n")
        kept = rows.read_text("utf-8") if rows.is_file() else ""
        whole = kept[: kept.rfind("\n") + 1]  # a kill may have torn the last line
        if whole != kept:
            files.replace_text(rows, whole)
    return {int(json.loads(line)[INDEX]) for line in whole.splitlines()}


def _row(point: Point, result: Any) -> dict[str, Any]:
    row = {INDEX: point.index, "outcome": "", "reason": "", "seed": point.seed}
    for name, value in point.values.items():
        row |= (
            asdict(value) if is_dataclass(value) and not isinstance(value, type) else {name: value}
        )
    return {**row, **result}


def _write_tables(folder: Path) -> None:
    pa = optional("pyarrow", "A study's table")
    cells = {name: pa.array(each, from_pandas=True) for name, each in read_table(folder).items()}
    table = pa.table(cells)
    with _writing(folder):
        with files.draft_of(folder / TABLE) as draft:
            optional("pyarrow.parquet", "A study's table").write_table(table, draft)
        with files.draft_of(folder / TEXT) as draft:
            optional("pyarrow.csv", "A study's table").write_csv(table, draft)


def read_table(folder: Path) -> dict[str, NDArray[Any]]:
    """Return all finished runs of a study by column, in the order of their numbers.

    What is neither a number nor a text is a text in JSON.

    Raises:
        StudyError: If the folder holds no study.
    """
    try:
        lines = (folder / ROWS).read_text("utf-8").splitlines()
    except OSError as error:
        raise StudyError(f"{folder / ROWS} cannot be read ({error.strerror}).") from None
    rows = sorted(map(json.loads, lines), key=lambda row: int(row[INDEX]))
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(cells: list[Any]) -> NDArray[Any]:
    kinds = {type(cell) for cell in cells}
    if len(kinds) == 1 and kinds <= {bool, int}:
        return np.array(cells)
    if kinds <= {bool, int, float, type(None)}:
        return np.array([math.nan if cell is None else cell for cell in cells], dtype=float)
    return np.array(
        [c if isinstance(c, str | None) else json.dumps(c) for c in cells], dtype=object
    )


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turn a failure to write into a sentence."""
    try:
        yield
    except OSError as error:
        raise StudyError(
            f"the results cannot be written to {folder} ({error.strerror or error}); "
            "make room there and repeat the command: what was written before is kept."
        ) from None


def read_description(folder: Path) -> dict[str, Any]:
    """Return what a study's folder says of it.

    Raises:
        StudyError: If it holds no study.
    """
    file = folder / DESCRIPTION
    try:
        found: dict[str, Any] = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise StudyError(f"{file} cannot be read ({error}); give the folder of a study.") from None
    return found


def _compare(before: Mapping[str, Any], now: Mapping[str, Any], folder: Path) -> None:
    for key in now:
        if before.get(key) != now[key]:
            texts = [f"{json.dumps(each.get(key)):.80}" for each in (before, now)]
            raise StudyError(
                f"{folder} holds another study: {key} is {texts[0]} there and {texts[1]} "
                "here; choose another --out, or repeat the first command."
            )
