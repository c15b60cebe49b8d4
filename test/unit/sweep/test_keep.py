# SPDX-License-Identifier: Apache-2.0
"""Studies that keep their results: the same table for any number of workers, after a kill, resumed.

The cluster is a real one: a scheduler and two workers, each a process.
"""

from __future__ import annotations

import functools
import json
import os
import resource
import signal
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
from tactile_hand_ros.sweep import backends, store
from tactile_hand_ros.sweep.backends import Backend, Cluster, Local
from tactile_hand_ros.sweep.keep import LAST_COLUMNS, Tally, keep
from tactile_hand_ros.sweep.runner import carry_out
from tactile_hand_ros.sweep.samplers import SAMPLERS
from tactile_hand_ros.sweep.space import Range, Space
from tactile_hand_ros.sweep.store import Store
from tactile_hand_ros.sweep.study import Study, StudyError, build, results_of, run_batch

TEST = Path(__file__).resolve().parents[3]
SPACE = Space({"x": Range(0.0, 1.0), "y": Range(1.0, 2.0)})
COLUMNS = {"x": float, "y": float, "seed": int, "xy_m": float, **LAST_COLUMNS}
RUNS = 300


def study(run=trials.product, runs: int = RUNS, seed: int = 5) -> Study:
    """Return a study of the unit square."""
    return Study(SPACE, "latin", run, list, runs, seed)


def kept(folder: Path, backend: Backend, watch=lambda _: None, **changes) -> Tally:
    """Carry out a study in a folder."""
    made = study(**changes)
    description = {"runs": made.runs, "seed": made.seed}
    return keep(
        made,
        Store(folder, COLUMNS, {"x": "kg"}),
        description,
        lambda point: {**point.values, "seed": point.seed},
        backend,
        watch,
    )


def tables(folder: Path) -> tuple[bytes, bytes]:
    """Return the bytes of both tables."""
    return (folder / store.TABLE).read_bytes(), (folder / store.TEXT).read_bytes()


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Return the tables of the study on one core."""
    folder = tmp_path_factory.mktemp("one")
    tally = kept(folder, Local(1))
    assert tally.done == tally.total == RUNS
    assert not (folder / "parts").exists()
    return tables(folder)


def test_a_row_says_all_of_a_run(expected: tuple[bytes, bytes], tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(expected[0])
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.column_names == ["run", *COLUMNS]
    assert table.schema.field("x").metadata == {b"unit": b"kg"}
    rows = table.to_pylist()
    assert [row["run"] for row in rows] == list(range(RUNS))
    for row in rows:
        seeds = np.random.SeedSequence([5, row["run"]])
        assert row["seed"] == int(seeds.generate_state(1)[0])
        assert row["build"] == build()
        if row["x"] > 0.9:
            assert row["outcome"] == "failed" and row["reason"] == f"x is {row['x']:.3f}"
            assert row["xy_m"] is None
        else:
            assert row["xy_m"] == row["x"] * row["y"] and row["reason"] == ""
    assert sum(row["outcome"] == "failed" for row in rows) == 30
    assert expected[1].decode().splitlines()[0] == ",".join(f'"{n}"' for n in table.column_names)


def test_two_processes_give_the_same_bytes(expected: tuple[bytes, bytes], tmp_path: Path) -> None:
    kept(tmp_path, Local(2))
    assert tables(tmp_path) == expected


def test_a_study_goes_on_where_it_was_interrupted(
    expected: tuple[bytes, bytes], tmp_path: Path
) -> None:
    """Ctrl-C keeps what is done, as tables too; the second call makes the rest only."""

    def interrupt(tally: Tally) -> None:
        if tally.done == 120:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(tmp_path, Local(1), interrupt)
    assert parquet.read_table(tmp_path / store.TABLE).num_rows == 120
    tally = kept(tmp_path, Local(1))
    assert tally.before == 120 and tally.outcomes.total() == RUNS - 120
    assert tables(tmp_path) == expected
    assert kept(tmp_path, Local(1)).outcomes.total() == 0
    assert tables(tmp_path) == expected


def test_parts_in_any_order_become_one_table_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_GROUP", 40)
    order = np.random.default_rng(0).permutation(500)
    made = Store(tmp_path, {"outcome": str}, {})
    made.begin({}, 500)
    for some in np.array_split(order, 23):
        made.add({"run": int(run), "outcome": str(run)} for run in some)
        made.flush()
    made.finish()
    table = parquet.ParquetFile(tmp_path / store.TABLE)
    assert table.read()["run"].to_pylist() == list(range(500))
    assert table.metadata.num_row_groups == 13
    assert Store(tmp_path, {"outcome": str}, {}).begin({}, 500).all()


def test_a_folder_holds_one_study(tmp_path: Path) -> None:
    kept(tmp_path, Local(1), runs=4)
    with pytest.raises(StudyError, match="another study: runs is 4 there and 5 here"):
        kept(tmp_path, Local(1), runs=5)


def test_a_full_disk_is_said_in_a_sentence_and_nothing_is_lost(
    expected: tuple[bytes, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel refuses to let any file grow over 3,000 bytes, as a disk without room would."""
    monkeypatch.setattr(store, "_ROWS", 20)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_up(tally: Tally) -> None:
        if tally.done == 100:
            resource.setrlimit(resource.RLIMIT_FSIZE, (3000, before[1]))

    try:
        with pytest.raises(StudyError, match=r"cannot be written to .*make room there and repeat"):
            kept(tmp_path, Local(1), fill_up)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    tally = kept(tmp_path, Local(1))
    assert tally.before >= 80
    assert tables(tmp_path) == expected


def test_a_process_that_dies_costs_its_runs_only(
    expected: tuple[bytes, bytes], tmp_path: Path
) -> None:
    deadly = functools.partial(trials.deadly, tmp_path / "mark")
    assert kept(tmp_path / "study", Local(2), run=deadly).done == RUNS
    assert (tmp_path / "mark").exists()
    assert tables(tmp_path / "study") == expected


def test_a_defect_is_a_failed_run_with_its_place(tmp_path: Path) -> None:
    tally = kept(tmp_path, Local(1), run=trials.broken, runs=3)
    assert tally.outcomes == {"failed": 3}
    reason = store.read_column(tmp_path, "reason")[0]
    assert reason.startswith("IndexError: list index out of range (trials.py:")


def test_a_study_without_a_folder_is_reduced_and_may_not_fail() -> None:
    points = Study(SPACE, "random", trials.product, lambda r: sorted(p.index for p, _ in r), 50)
    assert carry_out(points, Local(1)) == list(range(50))
    failing = Study(SPACE, "random", trials.broken, lambda r: list(results_of(r)), 5)
    with pytest.raises(StudyError, match="IndexError"):
        carry_out(failing, Local(1))


def test_the_driver_holds_a_few_runs_at_a_time() -> None:
    """Of a million points, only the slice at hand is drawn."""
    points = Study(SPACE, "sobol", trials.product, list, 10**6).points()
    assert next(points).index == 0
    design = SAMPLERS["random"](SPACE, 10**6, 0)
    assert design.rows(999_999, 10**6).shape == (1, 2)


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a scheduler and workers on the loopback; yield the scheduler file and the workers."""
    file = folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": f"{TEST}:{os.environ.get('PYTHONPATH', '')}"}
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    here = ["--host", "127.0.0.1"]

    def start(*words: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", *words, *common, *here],
            env=environment,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    started = [start("distributed.cli.dask_scheduler", "--port", "0")]
    try:
        for _ in range(workers):
            started.append(start("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny"))
        yield str(file), started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def wait_for(file: str, workers: int) -> Cluster:
    """Connect to a scheduler that is starting."""
    wait_until(Path(file).is_file, 60.0, "the scheduler to start")
    connected = Cluster(file, timeout=60.0)
    connected._client.wait_for_workers(workers, timeout=60.0)
    return connected


def test_a_cluster_that_loses_a_worker_gives_the_same_bytes(
    expected: tuple[bytes, bytes], tmp_path: Path
) -> None:
    with cluster(tmp_path, 2) as (file, workers):
        connected = wait_for(file, 2)
        assert connected.workers == 2

        def kill_one(tally: Tally) -> None:
            if tally.done == 20:
                workers[0].send_signal(signal.SIGKILL)

        tally = kept(tmp_path / "study", connected, kill_one)
        assert tally.done == RUNS and workers[0].wait(10.0) == -signal.SIGKILL
        assert tables(tmp_path / "study") == expected
        # Workers with other sources are refused, those that join later too.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(backends, "build", lambda: "9.9.9+0")
            with pytest.raises(StudyError, match="runs tactile_hand_ros .* this is 9.9.9") as told:
                kept(tmp_path / "other", connected)
            assert "install the same sources" in str(told.value)
            with pytest.raises(StudyError, match="^worker tcp://"):
                connected._check()
        connected.close()


def test_no_scheduler_is_said_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="no Dask scheduler answers at tcp://127.0.0.1:9 "):
        Cluster("tcp://127.0.0.1:9", timeout=0.5)
    with pytest.raises(StudyError, match="no scheduler file"):
        Cluster(str(tmp_path / "none.json"))
    with pytest.raises(StudyError, match="'nowhere', expected an address with its port"):
        Cluster("nowhere")
    (tmp_path / "bad.json").write_text(json.dumps({"address": "tcp://127.0.0.1:9"}))
    with pytest.raises(StudyError, match="no Dask scheduler answers"):
        Cluster(str(tmp_path / "bad.json"), timeout=0.5)


def test_another_build_runs_nothing() -> None:
    points = list(study(runs=2).points())
    assert run_batch(trials.product, points, "9.9.9+0") == ([], 0.0, build())
