# SPDX-License-Identifier: Apache-2.0
"""A run of a sweep, replayed through the nodes and recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.csv

from tactile_hand_ros.cli import main
from tactile_hand_ros.ros.middleware import isolated_domain
from tactile_hand_ros.run.run import Run


def test_a_run_of_a_sweep_is_replayed_as_a_recorded_run(tmp_path: Path) -> None:
    """The recorded run slides as far as its row says, to the bit."""
    out = tmp_path / "sweep"
    words = ["--over=plant.object.friction=0.3..0.6", "--over=plant.object.mass=0.1..0.3"]
    words += ["--set=duration=0.3", "--set=targets=[]", "--metric=slip", "--runs=4", "--jobs=1"]
    assert main(["sweep", "gravity", *words, f"--out={out}", "--format=png"]) == 0
    row = pyarrow.csv.read_csv(out / "runs.csv").to_pylist()[2]
    with isolated_domain():
        main(["sweep", str(out), "--rerun", "2"])
    run = Run(out / "runs" / "latest")
    assert run.scenario is not None
    assert run.scenario.plant.object.friction == row["plant.object.friction"]
    assert run.scenario.seed == row["seed"]
    assert float(np.nanmax(run.record.true_slid)) == row["max_slip_distance_m"]
