# SPDX-License-Identifier: Apache-2.0
"""Recovery times, on errors made by hand."""

import math

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.run.metrics import recoveries
from tactile_hand_ros.scenario.scenario import load_scenario

SCENARIO = load_scenario("pull")  # events at 2 and at 5 s


def record_of(error):
    """Return a record of 8 s at 100 Hz with an error that depends on time."""
    fingers = ["finger_1", "finger_2", "finger_3"]
    record = Record.empty(800, fingers, [f"j{i}" for i in range(9)])
    record.stamps[:] = np.arange(800) * 10_000_000
    record.desired_position[:] = 0.0
    record.auxiliary_position[:] = 0.0
    record.auxiliary_position[:, 2] = [error(t) for t in record.times]
    return record


def test_it_counts_from_the_event_until_the_error_stays_small():
    first, second = recoveries(
        record_of(lambda t: 0.01 * math.exp(-(t - 2.0) / 0.2) if t >= 2.0 else 0.0), SCENARIO
    )
    assert (first.start_s, second.start_s) == (2.0, 5.0)
    assert first.recovery_time_s == pytest.approx(0.2 * math.log(10.0), abs=0.011)
    assert first.largest_error_m == pytest.approx(0.01) and first.last_error_m < 1e-6
    assert second.recovery_time_s == 0.0


@pytest.mark.parametrize(
    ("error", "times"),
    [
        (lambda t: math.nan if 2.0 <= t < 3.0 else 0.0, (1.0, 0.0)),  # unknown is not back
        (lambda t: 0.001, (math.inf, math.inf)),
        (lambda t: math.nextafter(0.001, 0.0), (0.0, 0.0)),
        (lambda t: 0.003 if t >= 5.0 else 0.0, (0.0, math.inf)),
        (lambda t: 0.003 if t < 2.0 else 0.0, (0.0, 0.0)),
        (lambda t: 0.003 if t < 5.0 else 0.0, (math.inf, 0.0)),
        (lambda t: math.nan if t >= 5.0 else 0.0, (0.0, math.inf)),
    ],
)
def test_each_event_lasts_until_the_next_one(error, times) -> None:
    found = recoveries(record_of(error), SCENARIO)
    assert [each.recovery_time_s for each in found] == pytest.approx(times, abs=0.011)
    for each, span in zip(found, ((2.0, 5.0), (5.0, 8.0)), strict=True):
        known = [e for t in np.arange(*span, 0.01) if not math.isnan(e := error(t + 1e-9))]
        assert each.largest_error_m == pytest.approx(max(known, default=math.nan), nan_ok=True)


def test_a_run_in_which_nothing_happens_has_nothing_to_recover_from() -> None:
    assert recoveries(record_of(lambda t: 0.0), load_scenario("paper")) == []


def test_events_at_the_start_and_at_the_end_are_none() -> None:
    pushes = [{"kind": "step", "start": t, "force": [0.0, 3.0, 4.0]} for t in (0.0, 1.0, 1.0)]
    changed = {"plant.disturbances": pushes, "plant.friction_changes": [], "duration": 8.0}
    found = recoveries(record_of(lambda t: 0.0), load_scenario("pull", changed))
    assert [each.start_s for each in found] == [1.0]
    found = recoveries(record_of(lambda t: 0.0), load_scenario("pull", {"duration": 5.0}))
    assert [each.start_s for each in found] == [2.0]


def test_pushes_and_changes_of_friction_count_from_their_own_time_between_two_ticks() -> None:
    push = {"kind": "step", "start": 1.004, "force": [0.0, 3.0, 4.0]}
    changes = [{"start": 3.002, "friction": 0.2}]
    scenario = load_scenario(
        "pull", {"plant.disturbances": [push], "plant.friction_changes": changes, "duration": 8.0}
    )
    first, second = recoveries(record_of(lambda t: 0.002 if 1.0 < t < 1.495 else 0.0), scenario)
    assert (first.start_s, first.recovery_time_s) == (1.004, pytest.approx(0.496))
    assert (second.start_s, second.recovery_time_s) == (3.002, 0.0)
