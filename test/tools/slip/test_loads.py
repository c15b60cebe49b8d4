# SPDX-License-Identifier: Apache-2.0
"""Random loads: the same seed gives the same ones, and a reserve is what saves the object."""

import json

import pytest

from studies.slip.loads import (
    LoadCase,
    LoadOutcome,
    outcomes_of,
    run_load,
    run_loads,
    sample_loads,
    trade_offs,
)
from studies.slip.loads_report import rows
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.sweep.study import Batch, build

# A light object, hit by a pulse that twists it out of a pinch.
PULSE = LoadCase(0, "pinch", 0.054, 0.74, "pulse", 0.066, (0.0, -6.0, 0.0), (0.0, 0.0, 0.27))


def test_equal_seeds_give_equal_loads_of_every_kind():
    cases = sample_loads(100, 3)
    assert cases == sample_loads(100, 3) != sample_loads(100, 4)
    assert len({case.kind for case in cases}) == 4 and len({case.layout for case in cases}) == 2


def test_a_pulse_that_nothing_has_announced_slides_without_a_reserve_and_not_with_it():
    bare, ready = run_load(PULSE, 0.0), run_load(PULSE, 3.0)
    assert bare.survivable and ready.survivable
    assert bare.lost or bare.slip > 5e-3
    assert not ready.lost and ready.slip < 5e-3
    assert bare.squeeze < ready.squeeze < 20.0


def test_the_curve_counts_only_what_can_be_survived():
    kept = LoadOutcome(0.0, 0.1, 2.0, 1.0, True, False, 1e-3)
    slid = LoadOutcome(0.0, 0.1, 4.0, 1.0, True, False, 6e-3)
    lost = LoadOutcome(0.0, 0.1, 6.0, 1.0, True, True, 0.0)
    hopeless = LoadOutcome(0.0, 0.1, 9.0, 1.0, False, True, 0.0)
    other = LoadOutcome(0.0, 0.2, 9.0, 1.0, True, False, 0.0)
    [point, _] = trade_offs([kept, slid, lost, hopeless, other])
    assert (point.runs, point.squeeze, point.need, point.lost, point.slid) == (3, 4.0, 1.0, 1, 2)
    [row, _] = rows([kept, slid, lost, hopeless, other])
    assert row[:5] == ["0 N", "10 %", "3", "4.0 N", "4.0"] and row[5].startswith("33.3 %")


class Calls:
    """A backend that makes the results up, and stops after some of them as Ctrl-C does."""

    workers = 1

    def __init__(self, most):
        self.left, self.made = most, []

    def map(self, run, batches):
        for batch in batches:
            for point in batch:
                if not self.left:
                    raise KeyboardInterrupt
                self.left -= 1
                case, (floor, share) = point.values.values()
                self.made.append((case.index, floor))
                slip = 1e-3 * case.index
                came = {"squeeze": floor, "need": share, "survivable": True, "slip": slip}
                yield Batch([(point, {**came, "outcome": "reached"})], 0.01, build())


def test_a_study_that_was_interrupted_goes_on_and_ends_as_if_it_had_not_been(tmp_path):
    reserves = ((0.0, 0.2), (3.0, 0.2))

    def study(folder, most):
        calls = Calls(most)
        return run_loads(4, 7, folder, calls, reserves).done, calls.made

    with pytest.raises(KeyboardInterrupt):
        study(tmp_path / "halves", 3)
    done, rest = study(tmp_path / "halves", 100)
    total, everything = study(tmp_path / "whole", 100)
    assert done == total == 8 and everything[3:] == rest
    first, second = outcomes_of(tmp_path / "halves"), outcomes_of(tmp_path / "whole")
    assert first == second and [o.slip for o in first[2:]] == [1e-3, 1e-3, 2e-3, 2e-3, 3e-3, 3e-3]
    assert json.loads((tmp_path / "whole" / "study.json").read_text())["loads"] == 4
    with pytest.raises(TactileHandError, match="holds another study: seed is 7 there and 8 here"):
        run_loads(4, 8, tmp_path / "whole", Calls(0), reserves)


def test_a_run_that_failed_counts_as_a_loss(tmp_path):
    class Fails(Calls):
        def map(self, run, batches):
            for batch in super().map(run, batches):
                [(point, result)] = batch.results
                yield batch._replace(results=[(point, {"outcome": "failed", "reason": "diverged"})])

    run_loads(1, 7, tmp_path, Fails(100), ((3.0, 0.2),))
    [point] = trade_offs(outcomes_of(tmp_path))
    assert (point.runs, point.lost, point.slid) == (1, 1, 1)
