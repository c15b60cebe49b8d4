# SPDX-License-Identifier: Apache-2.0
"""The assumptions on the paper's grasp, and on records that violate them."""

import copy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.plants import plant

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.margins import GraspMonitor
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.assumptions import assumptions

HAND = Hand.load("paper")
UNKNOWN, STICK, SLIP = 0, 1, 2


@pytest.fixture(scope="module")
def paper():
    return simulate("paper", {"duration": 1.0}).record


@pytest.fixture
def record(paper):
    return copy.deepcopy(paper)


@pytest.fixture
def still():
    """Return forty 10 ms ticks during which the paper's hand keeps its first grasp."""
    state = plant().state
    seen = state.touch
    record = Record.empty(40, HAND.finger_names, HAND.joint_names)
    record.stamps[:] = 10_000_000 * np.arange(40)
    record.theta[:] = state.theta
    record.contact_positions[:], record.contact_quaternions[:] = seen.positions, seen.quaternions
    optimizer = ForceOptimizer(ForceOptimizerConfig(), 3)
    record.optimal_forces[:] = optimizer.solve(state.contacts).forces
    record.forces[:] = 10.0 * record.optimal_forces
    record.friction[:] = 0.5, 0.8, 1.1
    record.slip_evidence[:] = 0.1, 0.3, 0.2
    record.grip[:] = STICK
    return record


def lines(record):
    return {line.name: line for line in assumptions(record, HAND)}


def test_every_assumption_holds_in_the_papers_world(record):
    found = lines(record)
    assert list(found) == ["A1", "A2", "A3", "A4", "A4 cone", "A5", "A6", "A7", "(13)"]
    judged = [line for line in found.values() if not np.isnan(line.held_fraction)]
    assert len(judged) == 7
    assert all(line.held_fraction == 1.0 and not line.broken for line in judged)


def test_a_lost_contact_breaks_a7_for_as_long_as_it_lasts(record):
    record.contact_positions[200:300, 2] = np.nan
    line = lines(record)["A7"]
    assert line.worst == 0.0
    assert line.broken == [(pytest.approx(0.4), pytest.approx(0.598))]
    assert line.held_fraction == pytest.approx(1 - 100 / 476, abs=0.01)


def test_the_load_is_the_sum_of_all_forces_turned_into_the_palm(still):
    still.forces[20] = [[0.3, 2.0, -0.4], [-0.1, 1.0, 0.7], [0.5, 0.4, 0.2]]
    turns = [Rotation.from_quat(still.contact_quaternions[20, i]) for i in range(3)]
    net = sum(turns[i].apply(still.forces[20, i]) for i in range(3))
    line = lines(still)["A3"]
    assert line.worst == pytest.approx(np.linalg.norm(net)) and line.worst > 1.0
    assert line.broken == [(pytest.approx(0.2), pytest.approx(0.2))]
    assert line.held_fraction == pytest.approx(34 / 35)


def test_ticks_before_the_contacts_have_closed_do_not_count(still):
    still.forces[4, 0, 0] = 5.0
    assert lines(still)["A3"].held_fraction == 1.0
    still.forces[5, 0, 0] = 5.0  # at 50 ms
    assert lines(still)["A3"].held_fraction == pytest.approx(34 / 35)


def test_contacts_close_after_the_first_tick_whenever_that_is(still):
    still.stamps[:] += 17 * 10**17  # of a clock that counts from the epoch
    still.forces[4, 0, 0] = 5.0
    assert lines(still)["A3"].held_fraction == 1.0
    still.forces[6, 0, 0] = 5.0
    line = lines(still)["A3"]
    assert line.held_fraction < 1.0 and line.broken == [(still.times[6], still.times[6])]


def test_margins_are_those_of_each_posture(still):
    still.contact_positions[0] = still.contact_quaternions[0] = np.nan
    still.theta[20:] += np.linspace(-0.3, 0.4, 9)
    contacts = Contacts.from_poses(still.contact_positions[1], still.contact_quaternions[1])
    monitor, found = GraspMonitor(HAND), lines(still)
    first, later = (monitor.margins(still.theta[row], contacts) for row in (1, 20))
    assert found["A1"].worst == pytest.approx(later.face_travel) and later.face_travel > 1e-3
    assert found["A2"].worst == pytest.approx(min(first.hemisphere, later.hemisphere))
    assert found["A5"].worst == pytest.approx(min(first.joint, later.joint))
    assert found["A7"].worst == pytest.approx(first.collinearity)


def test_the_least_evidence_that_is_left_is_that_of_the_worst_contact_that_is_known(still):
    assert lines(still)["A4"].worst == pytest.approx(0.7)
    still.grip[:, 1] = UNKNOWN
    assert lines(still)["A4"].worst == pytest.approx(0.8)
    still.slip_evidence[30, 2] = 1.0  # exactly at the alarm
    line = lines(still)["A4"]
    assert line.worst == 0.0 and line.broken == [(pytest.approx(0.3), pytest.approx(0.3))]
    still.grip[12] = UNKNOWN, SLIP, STICK  # a slip leaves nothing
    assert lines(still)["A4"].broken[0] == (pytest.approx(0.12), pytest.approx(0.12))


def test_ticks_of_which_no_contact_is_known_are_not_judged(still):
    still.grip[10:25] = UNKNOWN
    still.slip_evidence[10:25] = 7.0
    line = lines(still)["A4"]
    assert (line.held_fraction, line.worst) == (1.0, pytest.approx(0.7))
    still.grip[30, 0], still.slip_evidence[30, 2] = UNKNOWN, 2.0
    assert lines(still)["A4"].held_fraction == pytest.approx(19 / 20)
    still.grip[:] = still.slip_evidence[:] = np.nan
    line = lines(still)["A4"]
    assert np.isnan(line.held_fraction) and np.isnan(line.worst)


def test_the_cone_that_is_nearest_is_that_of_a_contact_that_is_known(still):
    still.forces[:] = [[0.3, 2.0, 0.4], [0.0, 1.0, 0.7], [0.5, 4.0, 0.0]]
    left = [0.5 * 2.0 - 0.5, 0.8 - 0.7, 1.1 * 4.0 - 0.5]
    assert lines(still)["A4 cone"].worst == pytest.approx(left[1])
    still.grip[:, 1] = UNKNOWN
    assert lines(still)["A4 cone"].worst == pytest.approx(left[0])
    still.grip[:, 0] = np.nan
    still.friction[:, 0] = np.nan
    assert lines(still)["A4 cone"].worst == pytest.approx(left[2])


def test_a_slip_lasts_from_finger_to_finger_until_none_slips(still):
    """Five ticks of 10 ms, the last of them longer, then a second slip that is short enough."""
    still.stamps[12:] += 7_000_000
    still.grip[8:11, 0] = still.grip[10:13, 2] = SLIP
    still.grip[20, 1] = SLIP
    line = lines(still)["A6"]
    assert line.worst == pytest.approx(0.02 - 0.057)
    # Less than 20 ms are allowed: it is too long from its second tick on.
    assert line.broken == [(pytest.approx(0.09), pytest.approx(0.127))]


def test_how_long_a_slip_lasts_is_unknown_where_a_finger_says_nothing(still):
    still.grip[8:13, 0] = SLIP
    still.grip[11:13, 1] = np.nan
    line = lines(still)["A6"]
    assert line.worst == pytest.approx(0.02 - 0.03)
    assert line.held_fraction == pytest.approx(1 - 2 / 33)


@pytest.mark.parametrize(
    ("change", "residual"),
    [
        (lambda f: 1.2 * f, 0.2),
        (lambda f: 0.7 * f, 0.3),
        (lambda f: f - [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], 0.05),
        # Opposite faces with opposite x: shifted in opposite directions, they turn it about palm z.
        (lambda f: f - [[0.4, 0.0, 0.0], [0.4, 0.0, 0.0], [0.0, 0.0, 0.0]], 0.8 * 0.1302),
    ],
)
def test_f_out_of_balance_or_not_of_one_is_told_by_its_largest_residual(still, change, residual):
    assert lines(still)["(13)"].worst < 1e-9
    still.optimal_forces[33] = change(still.optimal_forces[33])
    line = lines(still)["(13)"]
    assert line.worst == pytest.approx(residual, rel=1e-3)
    assert line.broken == [(pytest.approx(0.33), pytest.approx(0.33))]


@pytest.mark.parametrize(
    ("ticks", "first", "last"), [(1998, 50, 1997), (2000, 50, 1998), (3000, 51, 2997)]
)
def test_of_a_long_run_about_a_thousand_ticks_are_looked_at(ticks, first, last):
    """No contact in these ticks, which violates A7 throughout; of the others nothing is known."""
    record = Record.empty(ticks, HAND.finger_names, HAND.joint_names)
    record.stamps[:] = 1_000_000 * np.arange(ticks)
    found = lines(record)
    assert found["A7"].broken == [(pytest.approx(1e-3 * first), pytest.approx(1e-3 * last))]
    assert found["A7"].held_fraction == 0.0
    unknown = ["A1", "A2", "A3", "A4 cone", "A5", "(13)"]
    assert all(np.isnan(found[name].worst) for name in unknown)
