# SPDX-License-Identifier: Apache-2.0
"""A gap is several missing ticks, or several without touch messages."""

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.run.derived import gaps, silent


def recorded(*steps: int) -> Record:
    """Return a record with touch, whose ticks are so many periods of 4 ms apart."""
    record = Record.empty(len(steps) + 1, ["a", "b"], ["j"])
    record.stamps[:] = 4_000_000 * np.cumsum([0, *steps])
    record.contact_positions[:] = 0.0
    record.forces[:] = 1.0
    return record


@pytest.mark.parametrize(("step", "found"), [(5, []), (6, [(3, 4)]), (500, [(3, 4)])])
def test_more_than_five_periods_without_a_tick_are_a_gap(step, found):
    assert gaps(recorded(1, 1, 1, step, 1, 1)) == found


@pytest.mark.parametrize(
    ("quiet", "found"),
    [
        (slice(10, 14), []),
        (slice(10, 15), [(9, 15)]),
        (slice(0, 5), [(0, 5)]),
        (slice(1, 6), [(0, 6)]),
        (slice(24, 29), [(23, 29)]),
        (slice(25, 30), [(24, 29)]),
        (slice(0, 30), []),  # no touch at all
    ],
)
def test_five_ticks_of_silence_are_a_gap(quiet, found):
    record = recorded(*29 * [1])
    record.contact_positions[quiet] = record.forces[quiet] = np.nan
    assert gaps(record) == found


def test_gaps_of_both_kinds_come_in_their_order():
    record = recorded(*10 * [1], 100, *10 * [1], 100, *10 * [1])
    record.contact_positions[12:18] = record.forces[12:18] = np.nan
    assert gaps(record) == [(10, 11), (11, 18), (21, 22)]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_two_ticks_have_no_gap(count):
    record = Record.empty(count, ["a"], ["j"])
    record.stamps[:] = 10**9 * np.arange(count)
    assert gaps(record) == []
    assert gaps(recorded(100, 1, 1)) == [(0, 1)]


def test_touch_is_silent_without_places_and_with_forces_that_do_not_belong_to_them():
    record = recorded(1, 1, 1, 1, 1, 1)
    nan = np.nan
    record.contact_positions[1:6] = nan
    record.contact_positions[5, 1] = 0.0  # one finger is enough
    record.forces[1:6, :, 1] = [[nan, nan], [0.0, 0.0], [0.0, 2.0], [nan, 0.0], [nan, nan]]
    assert silent(record).tolist() == [False, True, False, True, False, False, False]
