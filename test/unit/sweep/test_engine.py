# SPDX-License-Identifier: Apache-2.0
"""Studies keep their results: the same table for any number of workers, also when resumed.

The cluster is real: a scheduler and two workers.
"""

import csv
import json
from pathlib import Path

import distributed
import numpy as np
import pytest
from support import trials

from tactile_hand_ros.sweep import engine, table
from tactile_hand_ros.sweep.engine import Study, StudyError, in_parallel, workers
from tactile_hand_ros.sweep.space import Range
from tactile_hand_ros.sweep.table import keep, read_table

SPACE = {"x": Range(0.0, 1.0), "y": Range(1.0, 2.0)}
COLUMNS = ["run", "outcome", "reason", "seed", "x", "y", "xy_m"]
RUNS = 300


def kept(folder: Path, watch=lambda *_: None, run=trials.product, runs: int = RUNS) -> None:
    """Carry out a study of the unit square in a folder."""
    keep(Study(SPACE, run, runs, 5), folder, watch)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the table of the study on one core."""
    folder = tmp_path_factory.mktemp("one")
    kept(folder)
    return (folder / table.TABLE).read_bytes()


def test_a_row_says_all_of_a_run(expected):
    rows = list(csv.DictReader(expected.decode().splitlines()))
    assert list(rows[0]) == COLUMNS and len(rows) == RUNS
    for index, row in enumerate(rows):
        assert int(row["run"]) == index
        assert int(row["seed"]) == int(np.random.SeedSequence([5, index]).generate_state(1)[0])
        x, y = float(row["x"]), float(row["y"])
        if x > 0.9:
            assert row["outcome"] == "failed" and row["reason"] == f"x is {x:.3f}"
            assert row["xy_m"] == ""
        else:
            assert float(row["xy_m"]) == x * y and row["reason"] == ""
    assert sum(row["outcome"] == "failed" for row in rows) == 30


def test_two_processes_give_the_same_bytes(expected, tmp_path):
    with workers(2):
        kept(tmp_path)
    assert (tmp_path / table.TABLE).read_bytes() == expected


def test_a_study_goes_on_where_it_was_interrupted(expected, tmp_path):
    """Ctrl-C keeps all finished runs, as a table too; a kill may lose the last line."""

    def interrupt(done: int, total: int) -> None:
        if (done, total) == (120, RUNS):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(tmp_path, interrupt)
    assert (tmp_path / table.TABLE).read_text().count("\n") == 121
    rows = tmp_path / table.ROWS
    rows.write_text(rows.read_text() + '{"run": 29')
    finished: list[int] = []
    kept(tmp_path, lambda done, _: finished.append(done))
    assert finished == list(range(121, RUNS + 1))
    assert (tmp_path / table.TABLE).read_bytes() == expected
    kept(tmp_path, interrupt)
    assert len(read_table(tmp_path)["run"]) == RUNS


def test_a_folder_holds_one_study(tmp_path):
    kept(tmp_path, runs=4)
    with pytest.raises(StudyError, match="another study: runs is 4 there and 5 here"):
        kept(tmp_path, runs=5)
    with pytest.raises(StudyError, match="another study: seed is 5 there and 6 here"):
        keep(Study(SPACE, trials.product, 4, 6), tmp_path)
    for damaged in ("{", "[1]", ""):
        (tmp_path / table.DESCRIPTION).write_text(damaged)
        with pytest.raises(StudyError, match="another study"):
            kept(tmp_path, runs=4)
    (tmp_path / table.DESCRIPTION).unlink()  # whose rows these are is unknown
    with pytest.raises(StudyError, match="another study"):
        kept(tmp_path, runs=4)


def test_a_damaged_row_is_named(tmp_path):
    kept(tmp_path, runs=4)
    rows = tmp_path / table.ROWS
    rows.write_text(rows.read_text().replace('{"run": 2', '{"rum": 2'))
    with pytest.raises(StudyError, match=r"line \d of .* is damaged; delete it and repeat"):
        kept(tmp_path, runs=4)


def test_a_folder_that_cannot_be_written_is_said_in_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyError, match=r"cannot be written to .*make room there and repeat"):
        kept(tmp_path / "file")


def test_a_process_that_dies_ends_the_study_and_a_second_call_goes_on(expected, tmp_path):
    with workers(2), pytest.raises(StudyError, match="a process died during a run"):
        kept(tmp_path, run=trials.deadly)
    kept(tmp_path)
    assert (tmp_path / table.TABLE).read_bytes() == expected


def test_a_defect_is_a_failed_run_with_its_place(tmp_path):
    kept(tmp_path, run=lambda point: [][point.index], runs=3)
    found = read_table(tmp_path)
    reason = found["reason"][0]
    assert found["outcome"].tolist() == ["failed"] * 3
    assert reason.startswith("IndexError: list index out of range (test_engine.py:")


def test_lists_and_numbers_come_back_as_they_were(tmp_path):
    rows = [{"run": 1, "a": [1, 2], "b": None, "c": 3}, {"run": 0, "a": "x", "b": 0.5, "c": 4}]
    (tmp_path / table.ROWS).write_text("".join(json.dumps(row) + "\n" for row in rows))
    found = read_table(tmp_path)
    assert found["a"].tolist() == ["x", "[1, 2]"] and found["c"].dtype == int
    np.testing.assert_array_equal(found["b"], [0.5, np.nan])


def test_results_come_in_the_order_of_the_items():
    with workers(2):
        assert list(in_parallel(abs, range(-40, 0))) == list(range(40, 0, -1))


def test_a_cluster_gives_the_same_bytes(expected, tmp_path):
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**local) as cluster, workers(cluster=cluster.scheduler_address):
        kept(tmp_path / "study")
    assert (tmp_path / "study" / table.TABLE).read_bytes() == expected


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "without_a_port"])
def test_no_scheduler_is_said_in_a_sentence(address, monkeypatch):
    monkeypatch.setattr(engine, "_PATIENCE", 0.5)
    refused = pytest.raises(StudyError, match=f"no Dask scheduler answers at {address}")
    with refused, workers(cluster=address):
        pass
