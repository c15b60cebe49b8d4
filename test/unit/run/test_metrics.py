# SPDX-License-Identifier: Apache-2.0
"""Metrics of records that can be computed by hand, and how a goal judges them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.grasp import pose_error
from tactile_hand_ros.rotations import (
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
)
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.events import Asked, releases
from tactile_hand_ros.run.metrics import Judged, json_ready, metrics
from tactile_hand_ros.scenario.scenario import GoalConfig, Scenario

STRAIGHT = (0.0, 0.0, 0.0, 1.0)
SECOND = 1_000_000_000


def still_record(ticks: int = 11) -> Record:
    """Return 0.1 s ticks of a hand that holds an object at its target with three ideal forces."""
    record = Record.empty(ticks, ["a", "b", "c"], ["j1", "j2", "j3"])
    record.stamps[:] = np.arange(ticks) * SECOND // 10
    for array in (record.rates, record.theta, record.torque, record.command):
        array[:] = 0.0
    record.contact_positions[:] = np.eye(3)
    record.contact_quaternions[:] = STRAIGHT
    record.optimal_forces[:] = [[0.0, 0.5, 0.0], [0.0, 0.3, 0.0], [0.0, 0.2, 0.0]]
    record.grasp_force[:] = 10.0
    record.forces[:] = 10.0 * record.optimal_forces
    record.auxiliary_position[:] = 0.0
    record.auxiliary_quaternion[:] = STRAIGHT
    record.desired_position[:] = 0.0
    record.desired_quaternion[:] = STRAIGHT
    return record


def turned(angle: float) -> np.ndarray:
    return quaternion_from_rotation(rotation_from_vector([0.0, 0.0, angle]))


SCENARIO = Scenario(goal={"position_error": 0.01, "rotation_error": 0.1})


def test_a_perfect_run():
    m = metrics(still_record(), SCENARIO)
    assert (m.ticks, m.simulated_time_s, m.settling_time_s) == (11, 1.0, 0.0)
    assert m.final_position_error_m == m.final_rotation_error_rad == 0.0
    assert m.final_normal_forces_N == m.optimal_normal_forces_N == {"a": 5.0, "b": 3.0, "c": 2.0}
    assert m.worst_normal_force_relative_error == m.normal_force_sum_relative_error == 0.0
    assert m.normal_force_sum_N == m.final_grasp_force_N == 10.0
    assert m.contacts_lost_ticks == 0 and math.isnan(m.first_contact_loss_s)
    assert m.goal_reached is True


def test_final_errors_and_the_peak_rate():
    record = still_record()
    record.auxiliary_position[-1] = (0.003, 0.0, -0.004)
    record.auxiliary_quaternion[-1] = turned(0.2)
    record.rates[2, 1], record.rates[3] = -0.7, np.nan
    m = metrics(record)
    assert m.peak_joint_rate_rad_per_s == 0.7
    assert m.final_position_error_m == pytest.approx(0.005)
    assert m.final_rotation_error_rad == pytest.approx(2.0 * math.sin(0.2))
    assert m.goal_reached is None


@pytest.mark.parametrize(("slid", "reached"), [(0.01, True), (0.0101, False), (np.nan, True)])
def test_goal_of_not_slipping(slid, reached):
    """Unknown slip does not count against the run."""
    record = still_record()
    record.true_slid[-1, 1] = slid
    m = metrics(record, Scenario(goal={"slip_distance": 0.01}))
    assert m.goal_reached is reached
    assert m.max_slip_distance_m == pytest.approx(slid, nan_ok=True)


def test_before_a_command_the_first_pose_that_is_known_is_the_desired_one():
    record = still_record()
    record.desired_position[:] = record.desired_quaternion[:] = np.nan
    record.auxiliary_position[:, 0] = [np.nan, np.nan, *(0.25 * np.arange(9.0))]
    record.auxiliary_quaternion[:] = [turned(0.01 * row**2) for row in range(11)]
    assert metrics(record).final_position_error_m == 2.0
    record.auxiliary_quaternion[0] = np.nan
    expected = 2.0 * math.sin(1.0 - 0.01)
    assert metrics(record).final_rotation_error_rad == pytest.approx(expected)


def test_without_touch_the_true_forces_count():
    record = still_record()
    record.true_forces[:] = 3.0
    assert derived.contact_forces(record) is record.forces
    record.forces[:, 1:] = np.nan
    assert derived.contact_forces(record) is record.forces
    record.forces[:] = np.nan
    assert derived.contact_forces(record) is record.true_forces


def test_friction_is_required_where_place_and_force_of_a_contact_are_known():
    record = still_record()
    record.forces[:] = [0.3, 1.0, 0.4]
    record.contact_positions[2, 1] = np.nan
    record.forces[3, 0, 2] = np.nan
    expected = np.full((11, 3), 0.5)
    expected[2, 1] = expected[3, 0] = np.nan
    np.testing.assert_allclose(derived.required_friction(record), expected)


@pytest.mark.parametrize(
    ("forces", "worst", "total"),
    [
        ([5.25, 2.4, 2.1], 0.2, 9.75),  # too small
        ([5.25, 2.97, 2.6], 0.3, 10.82),  # too large
        ([5.5, 3.0, np.nan], np.nan, np.nan),
    ],
)
def test_forces(forces, worst, total):
    """The worst value is unknown if any finger's is unknown."""
    record = still_record()
    record.forces[-1, :, 1] = forces
    record.forces[3, 1, 1] = 50.0
    m = metrics(record)
    assert list(m.final_normal_forces_N.values()) == pytest.approx(forces, nan_ok=True)
    assert m.worst_normal_force_relative_error == pytest.approx(worst, nan_ok=True)
    assert m.normal_force_sum_N == pytest.approx(total, nan_ok=True)
    error = abs(total / 10.0 - 1.0)
    assert m.normal_force_sum_relative_error == pytest.approx(error, nan_ok=True)
    assert m.peak_normal_force_N == 50.0


def test_lost_contacts():
    record = still_record()
    record.contact_positions[6:8, 1] = record.contact_positions[7, 2] = np.nan
    record.forces[6:8, 1] = 0.0
    record.contact_positions[4] = record.forces[4] = np.nan
    m = metrics(record)
    assert (m.contacts_lost_ticks, m.first_contact_loss_s) == (2, pytest.approx(0.6))
    assert m.max_required_friction["b"] == 0.0


def test_up_to_four_ticks_at_the_end_may_lack_an_answer():
    """A recording may end between a tick and its answer."""
    record = still_record()
    record.auxiliary_position[6, 2], record.optimal_forces[6] = 0.004, [0.0, 0.4, 0.0]
    for array in (record.command, record.optimal_forces, record.grasp_force):
        array[7:] = np.nan
    record.auxiliary_position[7:] = record.auxiliary_quaternion[7:] = np.nan
    m = metrics(record, SCENARIO)
    assert (m.ticks, m.simulated_time_s, m.goal_reached) == (11, 1.0, True)
    assert (m.final_position_error_m, m.final_rotation_error_rad) == (pytest.approx(0.004), 0.0)
    assert m.optimal_normal_forces_N == pytest.approx({"a": 4.0, "b": 4.0, "c": 4.0})
    record.command[6] = np.nan
    m = metrics(record, SCENARIO)
    assert math.isnan(m.final_position_error_m) and m.goal_reached is False


def test_an_object_that_was_lost():
    """The final values are unknown: no number is made up, and the goal is not reached."""
    record = still_record()
    for array in (record.contact_positions, record.auxiliary_position, record.optimal_forces):
        array[5:] = np.nan
    record.auxiliary_quaternion[5:] = np.nan
    record.forces[5:] = 0.0
    m = metrics(record, SCENARIO)
    assert m.goal_reached is False
    for value in (m.final_position_error_m, m.final_rotation_error_rad, m.settling_time_s):
        assert math.isnan(value)
    assert math.isnan(m.worst_normal_force_relative_error)
    assert m.normal_force_sum_N == 0.0
    plain = m.to_dict()
    assert plain["final_position_error_m"] is None
    assert plain["optimal_normal_forces_N"] == {"a": None, "b": None, "c": None}
    json.dumps(plain, allow_nan=False)


def test_what_turns_as_one_neither_moves_in_the_grasp_nor_rolls():
    record, random = still_record(), np.random.default_rng(7)
    askew, place, spots = rotation_from_vector([0.5, -0.9, 0.2]), random.normal(size=3), np.eye(3)
    for tick in range(len(record)):
        turn, centre = rotation_from_vector(random.normal(size=3)), random.normal(size=3)
        record.auxiliary_position[tick] = centre
        record.auxiliary_quaternion[tick] = quaternion_from_rotation(turn)
        record.object_position[tick] = centre + turn @ place
        record.object_quaternion[tick] = quaternion_from_rotation(turn @ askew)
        record.true_positions[tick] = record.object_position[tick] + spots @ (turn @ askew).T
    moved, turned_by = derived.motion_in_grasp(record)
    assert max(moved.max(), turned_by.max(), derived.rolling(record).max()) < 1e-13


def test_motion_in_the_grasp_counts_from_the_first_tick_at_which_it_is_known():
    record = still_record()
    record.object_position[:], record.object_quaternion[:] = 0.0, STRAIGHT
    record.object_position[:2] = record.object_quaternion[1] = np.nan
    record.object_position[3, 0] = 0.01
    record.object_position[4:, 0] = -0.02
    record.object_quaternion[3] = turned(0.1)
    record.object_quaternion[4:] = turned(-0.2)
    moved, turned_by = derived.motion_in_grasp(record)
    assert np.isnan(moved[:2]).all() and moved[2] == turned_by[2] == 0.0
    assert (np.nanmax(moved), np.nanmax(turned_by)) == (0.02, pytest.approx(0.2))
    record.object_quaternion[5] = turned(math.pi)
    assert derived.motion_in_grasp(record)[1][5] == pytest.approx(math.pi)


def test_contacts_that_roll_over_the_object():
    record = still_record()
    record.object_position[:], record.object_quaternion[:] = 0.0, STRAIGHT
    record.true_positions[:] = np.eye(3)
    record.true_positions[0] = np.nan
    record.true_positions[4, 1, 2] += 0.03
    rolled = derived.rolling(record)
    assert np.isnan(rolled[0]).all() and rolled[4, 1] == pytest.approx(0.03)
    assert rolled[[1, 2, 3, *range(5, 11)]].max() == 0.0
    unknown = derived.rolling(still_record())
    assert unknown.shape == (11, 3) and np.isnan(unknown).all()


def test_records_that_hold_next_to_nothing():
    m = metrics(still_record(1), SCENARIO)
    assert (m.ticks, m.simulated_time_s, m.goal_reached) == (1, 0.0, True)
    m = metrics(Record.empty(3, [], ["j1"]))
    assert m.final_normal_forces_N == {} and m.contacts_lost_ticks == 0
    unknown = (m.worst_normal_force_relative_error, m.normal_force_sum_N, m.peak_normal_force_N)
    assert all(math.isnan(value) for value in unknown)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_rotation_error_is_that_of_the_laws(seed):
    random = np.random.default_rng(seed)
    record = still_record(2)
    record.auxiliary_quaternion[:] = random.normal(size=(2, 4))
    record.desired_quaternion[:] = random.normal(size=(2, 4))
    here = np.zeros(3)
    expected = [
        pose_error(here, rotation_from_quaternion(a), here, rotation_from_quaternion(d))[3:]
        for a, d in zip(record.auxiliary_quaternion, record.desired_quaternion, strict=True)
    ]
    np.testing.assert_allclose(derived.rotation_error(record), expected, atol=1e-14)


def test_plain_data_for_json():
    data = {"a": [1.0, math.nan, (math.inf, 2)], "b": {"c": -math.inf, "e": True}}
    assert json_ready(data) == {"a": [1.0, None, [None, 2]], "b": {"c": None, "e": True}}


def test_settling_counts_from_the_last_command_to_the_last_tick_outside():
    record = still_record()
    record.auxiliary_position[[1, 3, 4, 7], 0] = 1.0
    assert metrics(record, SCENARIO).settling_time_s == pytest.approx(0.8)
    record.desired_position[5:, 1] = 1e-4
    assert metrics(record, SCENARIO).settling_time_s == pytest.approx(0.3)
    record.desired_quaternion[6:] = record.auxiliary_quaternion[8:] = turned(0.2)
    assert metrics(record, SCENARIO).settling_time_s == pytest.approx(0.2)
    record.desired_position[7:, 1] = 2e-4
    assert metrics(record, SCENARIO).settling_time_s == pytest.approx(0.1)
    record.auxiliary_position[-1, 0] = 1.0
    assert math.isnan(metrics(record, SCENARIO).settling_time_s)


def test_peaks_of_friction_count_from_20_ms_on():
    record = still_record()
    record.stamps[:] = np.arange(11) * 10_000_000 + SECOND
    record.forces[1, 0], record.forces[2, 1] = (50.0, 10.0, 0.0), (6.0, 10.0, 8.0)
    found = metrics(record).max_required_friction
    assert found == pytest.approx({"a": 0.0, "b": 1.0, "c": 0.0})


GOAL = GoalConfig(position_error=0.01, rotation_error=0.1, slip_distance=0.002)
UNKNOWN = metrics(Record.empty(1, ["a"], ["j"]))


def test_each_number_is_judged_by_its_own_limit():
    known = replace(UNKNOWN, final_position_error_m=0.02, final_rotation_error_rad=0.05)
    assert known.judged(GOAL) == [
        Judged("final position error", 0.02, 0.01, "m"),
        Judged("final rotation error", 0.05, 0.1, "rad"),
    ]
    slid = replace(known, max_slip_distance_m=0.0).judged(GOAL)[2]
    assert slid == Judged("longest slip", 0.0, 0.002, "m")


@pytest.mark.parametrize(
    ("dropped", "steered", "reached", "words"),
    [
        (1.25, True, True, "object dropped at 1.250 s"),
        (0.0, False, False, "object dropped at 0.000 s"),
        (math.nan, True, False, "finished"),
        (math.nan, False, True, "goal reached"),
        (math.nan, False, False, "goal not reached"),
        (math.nan, False, None, ""),
    ],
)
def test_what_became_of_a_run(dropped, steered, reached, words):
    found = replace(UNKNOWN, dropped_at_s=dropped, goal_reached=reached)
    assert found.headline(steered=steered) == words


def test_the_hand_is_open_from_the_last_time_it_was_asked_to_until_it_grasps():
    opens, closes = Asked(2 * 10**9, "grasp", "false"), Asked(3 * 10**9, "grasp", "true")
    other = Asked(4 * 10**9, "enable", "false")
    assert releases([]) == releases([other]) == releases([opens, closes]) == []
    assert releases([opens, other]) == [2.0]
    assert releases([closes, opens, closes, opens._replace(stamp=5 * 10**9)]) == [5.0]
