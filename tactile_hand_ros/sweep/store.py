# SPDX-License-Identifier: Apache-2.0
"""Results of a study on disk: Parquet and CSV, one row a run, in the order of the runs.

Finished runs are appended as parts, each written in one step, so that a study that is killed goes
on where it was and the driver holds the newest rows only. In the end the parts become one table,
which is the same bytes for any number of workers and any order in which runs were done.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import files
from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.study import StudyError

DESCRIPTION, TABLE, TEXT = "study.json", "runs.parquet", "runs.csv"
INDEX = "run"
"""Name of the first column."""

_SECONDS, _ROWS = 10.0, 5_000  # after which what is new is written
_GROUP = 5_000  # rows of a row group of the table
_TYPES = {float: "float64", int: "int64", bool: "bool_", str: "string"}


class Store:
    """The folder of one study."""

    def __init__(self, folder: Path, columns: Mapping[str, type], units: Mapping[str, str]) -> None:
        """Name a folder and what a row holds.

        Args:
            folder: Of the study; `begin` creates it.
            columns: Type of each column after the first, by name.
            units: Units of some of them.

        Raises:
            MissingLibraryError: If pyarrow is not installed.
        """
        self.folder = folder
        self._parts = folder / "parts"
        self._arrow = optional("pyarrow", "A study's table")
        self._parquet = optional("pyarrow.parquet", "A study's table")
        self._texts = {name for name, kind in columns.items() if kind is str}
        self._schema = self._make_schema(columns, units)
        self._new: list[dict[str, Any]] = []
        self._written = time.monotonic()

    def _make_schema(self, columns: Mapping[str, type], units: Mapping[str, str]) -> Any:
        pa = self._arrow
        fields = [pa.field(INDEX, pa.int64())]
        for name, kind in columns.items():
            unit = {"unit": units[name]} if units.get(name) else None
            fields.append(pa.field(name, getattr(pa, _TYPES[kind])(), metadata=unit))
        return pa.schema(fields)

    def begin(self, description: Mapping[str, Any], runs: int) -> NDArray[np.bool_]:
        """Create the folder, or go on with the study in it.

        Args:
            description: Of the study, plain data.
            runs: Number of runs.

        Returns:
            Which runs are done, shape (runs,).

        Raises:
            StudyError: If the folder holds another study, or cannot be written.
        """
        file = self.folder / DESCRIPTION
        if file.exists():
            _compare(read_description(self.folder), json.loads(json.dumps(description)), file)
        with self._writing():
            self._parts.mkdir(parents=True, exist_ok=True)
            files.replace_text(file, json.dumps(description, indent=1) + "\n")
        done = np.zeros(runs, dtype=bool)
        for part in self._sources():
            done[self._parquet.ParquetFile(part).read([INDEX])[INDEX].to_numpy()] = True
        return done

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Take finished runs; now and then what is new is written.

        Raises:
            StudyError: If it cannot be written.
        """
        for row in rows:
            self._new.append({name: self._cell(name, value) for name, value in row.items()})
        if len(self._new) >= _ROWS or time.monotonic() > self._written + _SECONDS:
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
        if not self._new:
            return
        rows = sorted(self._new, key=lambda row: row[INDEX])
        table = self._arrow.Table.from_pylist(rows, self._schema)
        with self._writing(), files.draft_of(self._parts / _part(rows[0][INDEX])) as draft:
            with draft.open("xb") as file:
                self._parquet.write_table(table, file)
        self._new = []

    def finish(self) -> None:
        """Write the table of all finished runs; without a missing run the parts go.

        Raises:
            StudyError: If it cannot be written; the parts are kept.
        """
        self.flush()
        csv = optional("pyarrow.csv", "A study's table")
        table, text = self.folder / TABLE, self.folder / TEXT
        sources = self._sources()
        if sources in ([], [table]):
            return
        with self._writing(), files.draft_of(table) as first, files.draft_of(text) as second:
            with (
                first.open("xb") as file,
                second.open("xb") as other,
                self._parquet.ParquetWriter(file, self._schema) as writer,
                csv.CSVWriter(other, self._schema) as lines,
            ):
                for group in self._groups(sources):
                    writer.write_table(group)
                    lines.write_table(group)

    def close(self, runs: int) -> None:
        """Remove the parts once the table holds all runs."""
        table = self.folder / TABLE
        rows = self._parquet.ParquetFile(table).metadata.num_rows if table.is_file() else 0
        if rows == runs and self._parts.is_dir():
            # In one step: with some of the parts the study would look unfinished.
            shutil.rmtree(self._parts.rename(self.folder / ".parts"))

    def _sources(self) -> list[Path]:
        """Return the parts in the order of their first runs, or the table that they have become."""
        parts = sorted(self._parts.glob("[0-9]*.parquet")) if self._parts.is_dir() else []
        table = self.folder / TABLE
        return parts or ([table] if table.is_file() else [])

    def _groups(self, parts: Sequence[Path]) -> Iterator[Any]:
        """Yield all rows in order, as tables of one size, a few parts in memory at a time."""
        held = self._schema.empty_table()
        firsts = [int(path.stem) for path in parts]
        for path, following in zip(parts, [*firsts[1:], math.inf], strict=True):
            new = self._parquet.ParquetFile(path).read()
            held = self._arrow.concat_tables([held, new]).sort_by(INDEX)
            # Parts overlap where batches were done out of order.
            while len(held) > _GROUP and held[INDEX][_GROUP - 1].as_py() < following:
                yield held.slice(0, _GROUP).combine_chunks()
                held = held.slice(_GROUP)
        while len(held):
            yield held.slice(0, _GROUP).combine_chunks()
            held = held.slice(_GROUP)

    def _writing(self) -> _Writing:
        return _Writing(self.folder)


class _Writing:
    """Turns a failure to write into a sentence."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, kind: object, error: BaseException | None, _: object) -> None:
        """Say what is wrong."""
        if isinstance(error, OSError):
            raise StudyError(
                f"the results cannot be written to {self._folder} ({error.strerror or error}); "
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


def read_column(folder: Path, name: str) -> Any:
    """Return a column of a study's table as an array; NaN where a number is missing."""
    file = optional("pyarrow.parquet", "A study's table").ParquetFile(folder / TABLE)
    return file.read([name])[name].to_numpy()


def _compare(before: Mapping[str, Any], now: Mapping[str, Any], file: Path) -> None:
    for key in now:
        if before.get(key) != now[key]:
            raise StudyError(
                f"{file.parent} holds another study: {key} is {_short(before.get(key))} there and "
                f"{_short(now[key])} here; choose another --out, or repeat the first command."
            )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _part(first: int) -> str:
    return f"{first:012d}.parquet"
