# SPDX-License-Identifier: Apache-2.0
"""A campaign keeps each result at once, goes on where it stopped, and sums up."""

from contextlib import nullcontext

import pytest

from studies.faults import campaign, space, tables
from studies.faults.outcome import Outcome

RUNS = space.sample(12, seed=5, ways=("composed",))


def made(run, **values):
    given = {"moved": 0.001, "safe": 0.008, "peak": 20.0, "limit": 40.0, "recovered": 0.5}
    return Outcome(*run.cell, run.seed, **{**given, **values})


def test_what_is_kept_is_not_run_again(tmp_path):
    done = [made(run, dropped=index == 0) for index, run in enumerate(RUNS)]
    for _ in campaign.keep(tmp_path, iter(done[:7])):
        pass
    with (tmp_path / campaign.RESULTS).open("a") as file:
        file.write('{"way": "comp')  # as after a power cut
    known = campaign.load(tmp_path)
    assert known == done[:7]
    assert list(campaign.run_campaign(RUNS[:7], known)) == []


@pytest.mark.parametrize("broken", [None, 1])
def test_every_run_of_a_session_is_done_once_also_after_one_that_broke_it(monkeypatch, broken):
    cell = RUNS[0].cell
    runs = [space.Run(cell, seed) for seed in range(5)]

    def one(_, run):
        if run.seed == broken:
            raise TimeoutError("no answer")
        return made(run)

    monkeypatch.setattr(campaign, "RunningHand", lambda *_, **__: nullcontext())
    monkeypatch.setattr(campaign, "run_one", one)
    outcomes = list(campaign.run_campaign(runs))
    assert [outcome.seed for outcome in outcomes] == [0, 1, 2, 3, 4]
    assert [bool(outcome.error) for outcome in outcomes] == [s == broken for s in range(5)]


def test_the_tables_leave_out_what_could_not_be_judged():
    outcomes = [made(run) for run in RUNS]
    outcomes[0] = made(RUNS[0], starts=2)
    outcomes[1] = made(RUNS[1], error="TimeoutError: no answer")
    assert len(tables.judged(outcomes)) == len(RUNS) - 1
    first = tables.row("all", [made(RUNS[2], dropped=True), made(RUNS[3])])
    assert first == ["all", "2", "1", "9.5 to 90.5 %", "1.0", "8", "0.50", "0.50"]
