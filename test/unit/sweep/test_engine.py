# SPDX-License-Identifier: Apache-2.0
"""Studies that keep their results: the same table for any number of workers, and resumed.

The cluster is a real one: a scheduler and two workers, each a process.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest
from support import trials

from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.sweep import engine, table
from tactile_hand_ros.sweep.engine import Study, StudyError, in_parallel, workers
from tactile_hand_ros.sweep.space import Range
from tactile_hand_ros.sweep.table import Tally, keep, read_table

TEST = Path(__file__).resolve().parents[2]
SPACE = {"x": Range(0.0, 1.0), "y": Range(1.0, 2.0)}
COLUMNS = ["run", "outcome", "reason", "seed", "x", "y", "xy_m"]
RUNS = 300


def kept(folder: Path, watch=lambda _: None, run=trials.product, runs: int = RUNS) -> Tally:
    """Carry out a study of the unit square in a folder."""
    return keep(Study(SPACE, "latin", run, runs, 5), folder, {"runs": runs}, watch)


def tables(folder: Path) -> tuple[bytes, bytes]:
    """Return the bytes of both tables."""
    return (folder / table.TABLE).read_bytes(), (folder / table.TEXT).read_bytes()


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Return the tables of the study on one core."""
    folder = tmp_path_factory.mktemp("one")
    tally = kept(folder)
    assert tally.done == tally.total == RUNS
    return tables(folder)


def test_a_row_says_all_of_a_run(expected: tuple[bytes, bytes], tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(expected[0])
    found = parquet.read_table(tmp_path / "t.parquet")
    assert found.column_names == COLUMNS
    rows = found.to_pylist()
    assert [row["run"] for row in rows] == list(range(RUNS))
    for row in rows:
        seeds = np.random.SeedSequence([5, row["run"]])
        assert row["seed"] == int(seeds.generate_state(1)[0])
        if row["x"] > 0.9:
            assert row["outcome"] == "failed" and row["reason"] == f"x is {row['x']:.3f}"
            assert row["xy_m"] is None
        else:
            assert row["xy_m"] == row["x"] * row["y"] and row["reason"] == ""
    assert sum(row["outcome"] == "failed" for row in rows) == 30
    assert expected[1].decode().splitlines()[0] == ",".join(f'"{n}"' for n in found.column_names)


def test_two_processes_give_the_same_bytes(expected: tuple[bytes, bytes], tmp_path: Path) -> None:
    with workers(2):
        kept(tmp_path)
    assert tables(tmp_path) == expected


def test_a_study_goes_on_where_it_was_interrupted(
    expected: tuple[bytes, bytes], tmp_path: Path
) -> None:
    """Ctrl-C keeps what is done, as tables too; so does a kill, but for a torn last line."""

    def interrupt(tally: Tally) -> None:
        if tally.done == 120:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(tmp_path, interrupt)
    assert parquet.read_table(tmp_path / table.TABLE).num_rows == 120
    rows = tmp_path / table.ROWS
    rows.write_text(rows.read_text() + '{"run": 29')
    tally = kept(tmp_path)
    assert tally.before == 120 and tally.outcomes.total() == RUNS - 120
    assert tables(tmp_path) == expected
    assert kept(tmp_path).outcomes.total() == 0


def test_a_folder_holds_one_study(tmp_path: Path) -> None:
    kept(tmp_path, runs=4)
    with pytest.raises(StudyError, match="another study: runs is 4 there and 5 here"):
        kept(tmp_path, runs=5)


def test_a_folder_that_cannot_be_written_is_said_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyError, match=r"cannot be written to .*make room there and repeat"):
        kept(tmp_path / "file")


def test_a_process_that_dies_ends_the_study_and_a_second_call_goes_on(
    expected: tuple[bytes, bytes], tmp_path: Path
) -> None:
    with workers(2), pytest.raises(StudyError, match="a process died while it made a run"):
        kept(tmp_path, run=trials.deadly)
    kept(tmp_path)
    assert tables(tmp_path) == expected


def test_a_defect_is_a_failed_run_with_its_place(tmp_path: Path) -> None:
    assert kept(tmp_path, run=trials.broken, runs=3).outcomes == {"failed": 3}
    reason = read_table(tmp_path)["reason"][0]
    assert reason.startswith("IndexError: list index out of range (trials.py:")


def test_a_study_needs_no_folder() -> None:
    results = list(Study(SPACE, "random", trials.product, 50).results())
    assert sorted(point.index for point, _ in results) == list(range(50))
    [(_, failed)] = Study(SPACE, "random", trials.broken, 1).results()
    assert failed["outcome"] == "failed"


def test_results_come_in_the_order_of_the_items() -> None:
    with workers(2):
        assert list(in_parallel(abs, range(-40, 0))) == list(range(40, 0, -1))


@contextmanager
def cluster(folder: Path) -> Iterator[str]:
    """Start a scheduler and two workers on the loopback; yield the scheduler file."""
    file = folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": f"{TEST}:{os.environ.get('PYTHONPATH', '')}"}
    common = ["--scheduler-file", str(file), "--no-dashboard", "--host", "127.0.0.1"]
    worker = ["distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny"]
    started = [
        subprocess.Popen(
            [sys.executable, "-m", *words, *common],
            env=environment,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for words in (["distributed.cli.dask_scheduler", "--port", "0"], worker, worker)
    ]
    try:
        wait_until(file.is_file, 60.0, "the scheduler to start")
        yield str(file)
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_a_cluster_gives_the_same_bytes(
    expected: tuple[bytes, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_PATIENCE", 60.0)
    with cluster(tmp_path) as file, workers(cluster=file):
        assert kept(tmp_path / "study").done == RUNS
    assert tables(tmp_path / "study") == expected


def test_no_scheduler_is_said_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_PATIENCE", 0.5)
    for place in ("tcp://127.0.0.1:9", str(tmp_path / "none.json")):
        refused = pytest.raises(StudyError, match="no Dask scheduler answers at")
        with refused, workers(cluster=place):
            pass
