# SPDX-License-Identifier: Apache-2.0
"""Results of a study on disk: one row a run, kept as they come, in the end Parquet and CSV.

Rows are appended to a file of JSON lines, so that a study that is killed continues where it was.
From it the tables are made, the same bytes for any number of workers and any order of runs.
"""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_hand_ros import files
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.engine import Failure, Point, Study, StudyError, build
from tactile_hand_ros.sweep.statistics import fraction_of

DESCRIPTION, ROWS, TABLE, TEXT = "study.json", "runs.jsonl", "runs.parquet", "runs.csv"
INDEX = "run"
"""Name of the first column."""

REACHED, MISSED, LOST, FAILED = "reached", "missed", "lost", "failed"
OUTCOMES = (REACHED, MISSED, LOST, FAILED)
"""Of a run: the goal was reached; the object is held, but not at its target, or it has slid too
far; a contact is missing at the end; it raised an error."""

LAST_COLUMNS = {"outcome": str, "reason": str, "build": str}

_SECONDS = 10.0  # after which what is new is written
_TYPES = {float: "float64", int: "int64", bool: "bool_", str: "string"}


@dataclass
class Tally:
    """How far a study is.

    Attributes:
        total: Number of runs.
        before: Runs that were done before it began.
        outcomes: How often each outcome came since.
        began: When, on the clock of `time.monotonic`, s.
    """

    total: int
    before: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    began: float = field(default_factory=time.monotonic)

    @property
    def done(self) -> int:
        """Number of finished runs."""
        return self.before + self.outcomes.total()

    @property
    def rate(self) -> float:
        """Runs per second since the beginning."""
        return self.outcomes.total() / max(time.monotonic() - self.began, 1e-9)

    @property
    def left(self) -> float:
        """Time left, s."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else math.inf

    def __str__(self) -> str:
        """Return how many failed, how fast it goes, and an early look at the result."""
        fraction, low, high = fraction_of(self.outcomes[REACHED], self.outcomes.total())
        speed = f"{self.rate:.3g} runs/s"
        if math.isnan(fraction):
            return speed
        reached = f"{100 * fraction:.0f} % ({100 * low:.0f} to {100 * high:.0f}) reach the goal"
        return f"{self.outcomes[FAILED]} failed, {speed}, {reached}"


class Store:
    """The folder of one study."""

    def __init__(self, folder: Path, columns: Mapping[str, type], units: Mapping[str, str]) -> None:
        """Name a folder and what a row holds.

        Args:
            folder: Of the study; created where it is missing.
            columns: Type of each column after the first, by name.
            units: Units of some of them.

        Raises:
            MissingLibraryError: If pyarrow is not installed.
        """
        pa = optional("pyarrow", "A study's table")
        self.folder = folder
        self._texts = {name for name, kind in columns.items() if kind is str}
        fields = [pa.field(INDEX, pa.int64())]
        for name, kind in columns.items():
            unit = {"unit": units[name]} if units.get(name) else None
            fields.append(pa.field(name, getattr(pa, _TYPES[kind])(), metadata=unit))
        self._schema = pa.schema(fields)
        self._new: list[str] = []
        self._written = time.monotonic()

    def begin(self, description: Mapping[str, Any]) -> set[int]:
        """Create the folder, or continue the study in it; return the runs that are done.

        Raises:
            StudyError: If the folder holds another study, or cannot be written.
        """
        file = self.folder / DESCRIPTION
        if file.exists():
            _compare(read_description(self.folder), json.loads(json.dumps(description)), file)
        with self._writing():
            self.folder.mkdir(parents=True, exist_ok=True)
            files.replace_text(file, json.dumps(description, indent=1) + "\n")
            rows = self.folder / ROWS
            kept = rows.read_text("utf-8") if rows.is_file() else ""
            whole = kept[: kept.rfind("\n") + 1]  # a kill may have torn the last line
            if whole != kept:
                files.replace_text(rows, whole)
        return {int(json.loads(line)[INDEX]) for line in whole.splitlines()}

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a finished run; now and then what is new is written.

        Raises:
            StudyError: If it cannot be written.
        """
        self._new.append(json.dumps({name: self._cell(name, v) for name, v in row.items()}) + "\n")
        if time.monotonic() > self._written + _SECONDS:
            self.flush()

    def _cell(self, name: str, value: Any) -> Any:
        """Return a value as its column takes it: NaN as missing, structures as JSON."""
        if isinstance(value, float) and math.isnan(value):
            return None
        return json.dumps(value) if name in self._texts and not isinstance(value, str) else value

    def flush(self) -> None:
        """Write what is new.

        Raises:
            StudyError: If it cannot be written; what was written before is kept.
        """
        self._written = time.monotonic()
        with self._writing(), (self.folder / ROWS).open("a", encoding="utf-8") as file:
            file.write("".join(self._new))
        self._new = []

    def finish(self) -> None:
        """Write the tables of all finished runs.

        Raises:
            StudyError: If they cannot be written; the rows are kept.
        """
        self.flush()
        pa = optional("pyarrow", "A study's table")
        lines = (self.folder / ROWS).read_text("utf-8").splitlines()
        rows = sorted(map(json.loads, lines), key=lambda row: int(row[INDEX]))
        table = pa.Table.from_pylist(rows, self._schema)
        with self._writing():
            with files.draft_of(self.folder / TABLE) as draft:
                optional("pyarrow.parquet", "A study's table").write_table(table, draft)
            with files.draft_of(self.folder / TEXT) as draft:
                optional("pyarrow.csv", "A study's table").write_csv(table, draft)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn a failure to write into a sentence."""
        try:
            yield
        except OSError as error:
            raise StudyError(
                f"the results cannot be written to {self.folder} ({error.strerror or error}); "
                "make room there and repeat the command: what was written before is kept."
            ) from None


def keep(
    study: Study,
    store: Store,
    description: Mapping[str, Any],
    parameters: Callable[[Point], Mapping[str, Any]],
    watch: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Make all runs that are not done yet and write the table of all that are.

    Args:
        study: Its runs return a mapping of columns, `outcome` among them.
        store: Where results go; holds those of an earlier, unfinished call.
        description: Of the study, plain data; a folder holds one study.
        parameters: Returns the columns of a run that are known before it.
        watch: Called after each run.

    Raises:
        StudyError: If the folder holds another study or cannot be written, or processes die.
    """
    total = len(study.fractions)
    done = store.begin({**description, "build": build()})
    tally = Tally(total, len(done))
    if tally.before == total and (store.folder / TABLE).is_file():
        return tally
    ensure_compiled()
    try:
        for point, result in study.results(i for i in range(total) if i not in done):
            row = {INDEX: point.index, "reason": "", "build": build(), **parameters(point)}
            if isinstance(result, Failure):
                result = {"outcome": FAILED, "reason": result.reason}
            store.add({**row, **result})
            tally.outcomes[result["outcome"]] += 1
            watch(tally)
    finally:
        store.finish()
    return tally


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


def read_column(folder: Path, name: str) -> Any:
    """Return a column of a study's table as an array; NaN where a number is missing."""
    file = optional("pyarrow.parquet", "A study's table").ParquetFile(folder / TABLE)
    return file.read([name])[name].to_numpy()


def _compare(before: Mapping[str, Any], now: Mapping[str, Any], file: Path) -> None:
    for key in now:
        if before.get(key) != now[key]:
            texts = [f"{json.dumps(each.get(key)):.80}" for each in (before, now)]
            raise StudyError(
                f"{file.parent} holds another study: {key} is {texts[0]} there and {texts[1]} "
                "here; choose another --out, or repeat the first command."
            )
