# SPDX-License-Identifier: Apache-2.0
"""Drops and gaps: fewer than two fingers touch until the end; ticks or touch are missing."""

import math

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.report.scene import grasp_figure
from tactile_hand_ros.run.derived import dropped_at, gaps, pose_errors, silent
from tactile_hand_ros.run.events import events
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario


def touched(*fingers: int) -> Record:
    """Return a record with given numbers of touching fingers, of three, at ticks of 0.1 s."""
    record = Record.empty(len(fingers), ["a", "b", "c"], ["j"])
    record.stamps[:] = 100_000_000 * np.arange(len(fingers))
    for row, count in enumerate(fingers):
        record.contact_positions[row, :count] = 0.0
        record.forces[row] = 0.0
    return record


@pytest.mark.parametrize(
    ("fingers", "time"),
    [
        ((3, 3, 3), math.nan),
        ((3, 2, 2), math.nan),  # two can hold
        ((3, 1, 0), 0.1),
        ((3, 0, 3, 0, 0), 0.3),  # caught once
        ((0, 0, 3, 3), math.nan),
        ((0, 0), math.nan),  # it was never in the hand
        ((), math.nan),
    ],
)
def test_a_drop_is_for_good(fingers, time):
    assert dropped_at(touched(*fingers)) == pytest.approx(time, nan_ok=True)


def test_the_ground_truth_judges_a_drop_where_there_is_one():
    failed, real = touched(3, 3, 1, 1), touched(3, 3, 3, 3)
    for record in (failed, real):
        record.true_forces[:] = record.true_positions[:] = 0.0
    assert math.isnan(dropped_at(failed))
    real.true_positions[3:, 1:] = np.nan
    assert dropped_at(real) == pytest.approx(0.3)
    failed.true_forces[:] = np.nan
    assert dropped_at(failed) == pytest.approx(0.2)


def test_what_is_let_go_is_not_dropped():
    assert math.isnan(dropped_at(touched(3, 3, 0), releases=[0.1]))
    assert dropped_at(touched(3, 3, 0, 0), releases=[0.3]) == pytest.approx(0.2)
    lost = touched(3, 3, 0)
    assert math.isnan(dropped_at(lost, releases=[float(lost.times[2])]))


def test_after_a_drop_there_is_no_pose_error():
    """The last observed pose does not apply to a dropped object."""
    record = touched(3, 3, 1, 1)
    record.desired_position[:], record.auxiliary_position[:] = 0.0, [0.0, 0.0, 0.1]
    record.desired_quaternion[:] = record.auxiliary_quaternion[:] = [0.0, 0.0, 0.0, 1.0]
    found = metrics(record)
    assert found.dropped_at_s == pytest.approx(0.2) and math.isnan(found.final_position_error_m)
    position, rotation = pose_errors(record, found.dropped_at_s)
    np.testing.assert_allclose(position, [0.1, 0.1, np.nan, np.nan])
    np.testing.assert_allclose(rotation, [0.0, 0.0, np.nan, np.nan])
    np.testing.assert_allclose(pose_errors(record, math.nan)[0], 0.1)


def test_ticks_that_were_not_recorded_are_no_drop():
    record = touched(3, 3, 0, 0)
    record.forces[2:] = np.nan
    assert math.isnan(dropped_at(record))
    record = touched(3, 0, 3, 0, 0)
    record.forces[1] = np.nan
    assert dropped_at(record) == pytest.approx(0.3)


@pytest.fixture(scope="module")
def dropped() -> tuple[Record, Scenario]:
    """Return the README's pull without slip prevention, which no constant grasp force holds."""
    scenario = load_scenario("pull", {"slip_regulator.mode": "user", "duration": 2.5})
    return ClosedLoop(scenario).run(), scenario


def test_the_pull_without_slip_prevention_is_called_a_drop(dropped):
    m = metrics(*dropped)
    assert 2.0 < m.dropped_at_s < 2.5
    assert m.goal_reached is False
    assert m.slip_count and m.max_slip_distance_m > 0.001
    assert m.headline() == f"object dropped at {m.dropped_at_s:.3f} s"
    found = [each for each in events(*dropped, dropped=m.dropped_at_s) if each.kind == "dropped"]
    assert [each.time for each in found] == [m.dropped_at_s]


def test_the_figure_shows_the_hand_and_not_the_fall(dropped):
    figure = grasp_figure(*dropped)
    assert any("object dropped at 2" in text.get_text() for text in figure.texts)
    sizes = [float(np.ptp(axes.get_zlim())) for axes in figure.axes]
    assert max(sizes) < 1.0  # m; by then the object is farther down
    assert dropped[0].object_position[-1, 2] < -1.0


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


def test_two_ticks_have_no_gap():
    assert gaps(Record.empty(0, ["a"], ["j"])) == gaps(recorded()) == gaps(recorded(100)) == []
    assert gaps(recorded(100, 1, 1)) == [(0, 1)]


def test_touch_is_silent_without_places_and_with_forces_that_do_not_belong_to_them():
    record = recorded(1, 1, 1, 1, 1, 1)
    nan = np.nan
    record.contact_positions[1:6] = nan
    record.contact_positions[5, 1] = 0.0  # one finger is enough
    record.forces[1:6, :, 1] = [[nan, nan], [0.0, 0.0], [0.0, 2.0], [nan, 0.0], [nan, nan]]
    assert silent(record).tolist() == [False, True, False, True, False, False, False]
