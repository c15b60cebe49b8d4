# SPDX-License-Identifier: Apache-2.0
"""Random loads: the same seed gives the same ones, and a reserve is what saves the object."""

import pytest

from studies.slip.loads import (
    LoadCase,
    LoadOutcome,
    outcomes_of,
    rows,
    run_load,
    run_loads,
    sample_loads,
    trade_offs,
)
from tactile_hand_ros.errors import TactileHandError

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


def test_a_study_that_was_interrupted_goes_on_and_ends_as_if_it_had_not_been(tmp_path):
    reserves = ((0.0, 0.2), (3.0, 0.2))

    def interrupt(tally):
        if tally.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_loads(2, 7, tmp_path, reserves, interrupt)
    tally = run_loads(2, 7, tmp_path, reserves)
    assert (tally.before, tally.done) == (1, 4)
    found = outcomes_of(tmp_path)
    assert found[0] == run_load(sample_loads(2, 7)[0], 0.0)
    assert [(o.floor, o.share) for o in found] == [*reserves, *reserves]
    with pytest.raises(TactileHandError, match="holds another study: seed is 7 there and 8 here"):
        run_loads(2, 8, tmp_path, reserves)
