# SPDX-License-Identifier: Apache-2.0
"""A campaign keeps each result, continues where it stopped, and sums up."""

from contextlib import nullcontext

import numpy as np
import pytest

from studies.faults import campaign, space
from studies.faults.outcome import Outcome
from tactile_hand_ros.sweep.table import read_table

RUNS = [space.Injection("composed", "at rest", "computer", "stopped", seed) for seed in range(5)]
SEEN = {"moved": 0.001, "safe": 0.008, "peak": 20.0, "limit": 40.0, "recovered": 0.5}


def test_every_run_is_made_once_also_after_one_that_broke_the_nodes(monkeypatch, tmp_path):
    starts, seeds = [], []

    def started(*_, **__):
        starts.append(len(seeds))
        return nullcontext()

    def inject(_, run):
        seeds.append(run.seed)
        if run.seed == 1:
            raise TimeoutError("no answer")
        return Outcome(dropped=run.seed == 3, declared="", **SEEN)

    monkeypatch.setattr(campaign, "RunningHand", started)
    monkeypatch.setattr(campaign, "inject", inject)

    def interrupt(done, _):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign.run_campaign(RUNS, tmp_path, watch=interrupt)
    campaign.run_campaign(RUNS, tmp_path)
    assert seeds == [0, 1, 2, 3, 4] and starts == [0, 2, 3]
    table = read_table(tmp_path)
    assert table["outcome"].tolist() == ["reached", "failed", "reached", "lost", "reached"]
    assert table["reason"][1].startswith("TimeoutError: no answer (test_campaign.py:")
    [_, all_faults, *_] = campaign.rows([table])
    assert all_faults[:4] == ["composed, all faults", "4", "1", "4.6 to 69.9 %"]
    assert all_faults[4:] == ["1.0", "8", "0.50", "0.50"]
    assert campaign.row("x", table, np.zeros(5, dtype=bool)) == ["x", "0", *["-"] * 6]
