# SPDX-License-Identifier: Apache-2.0
"""Margins of A1 to A7 on the paper's grasp, and on what breaks them."""

import numpy as np
import pytest
from support.plants import plant

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.hand import Hand
from tactile_hand_ros.core.margins import REACTION, GraspWatch, SlipWatch, cone_distances
from tactile_hand_ros.core.rotations import rotation_from_vector
from tactile_hand_ros.core.slip_detector import Grip

MS = 1_000_000
HOLDS = np.array([[0.2, 1.0, 0.1], [0.0, 2.0, 0.4], [0.3, 1.0, 0.0]])
STICK, LOOSE = np.full(3, int(Grip.STICK)), np.full(3, int(Grip.UNKNOWN))
MU = np.full(3, 0.5)


@pytest.fixture
def grasp():
    state = plant().state
    return state.theta, state.contacts


def note(watch, stamp, contacts, grip=STICK, evidence=0.1, forces=HOLDS):
    watch.note(stamp, contacts, forces, MU, grip, np.full(3, evidence))


def test_the_papers_grasp_is_far_from_every_edge(grasp):
    margins = GraspWatch(Hand.load("paper")).margins(*grasp)
    # The last links point 30 degrees above the horizontal.
    assert margins.hemisphere == pytest.approx(np.radians(60.0), abs=2e-3)
    assert margins.face_travel == 0.0
    assert margins.joint > 0.05 and margins.collinearity > 0.5


def test_travel_counts_from_the_first_contacts_until_one_is_lost(grasp):
    theta, contacts = grasp
    watch = GraspWatch(Hand.load("paper"))
    watch.margins(theta, contacts)
    bent = theta.copy()
    bent[2] += 0.1  # turns the fingertip under its contact by 0.1 rad: 6 mm of 60
    assert watch.margins(bent, contacts).face_travel == pytest.approx(0.006, rel=0.05)
    # Rolling round the axis of the tip leads to an edge of the face as well.
    axis = Hand.load("paper").tip_rotations(theta)[0][:, 0]
    rolled = contacts.rotations.copy()
    rolled[0] = rotation_from_vector(0.1 * axis) @ rolled[0]
    turned = watch.margins(theta, Contacts(contacts.positions, rolled)).face_travel
    assert turned == pytest.approx(0.006 * np.sin(np.radians(30.0)), rel=0.05)
    gone = contacts.positions.copy()
    gone[1] = np.nan
    lost = watch.margins(bent, Contacts(gone, contacts.rotations))
    assert lost.collinearity == 0.0 and np.isnan(lost.hemisphere)
    assert watch.margins(bent, contacts).face_travel == 0.0


def test_distance_to_the_cones():
    np.testing.assert_allclose(
        cone_distances(HOLDS, MU), [0.5 - np.hypot(0.2, 0.1), 0.6, 0.2], atol=1e-12
    )


def test_the_worst_of_an_interval_is_told_and_a_new_one_begins(grasp):
    contacts, watch = grasp[1], SlipWatch()
    note(watch, 0, contacts)
    note(watch, MS, contacts, evidence=0.7, forces=0.5 * HOLDS)
    note(watch, 2 * MS, contacts)
    assert watch.evidence == pytest.approx(0.3)
    assert watch.cone == pytest.approx(0.1)
    assert watch.time_left == REACTION and watch.load > 0.0
    watch.clear()
    assert np.isnan(watch.evidence) and np.isnan(watch.cone) and np.isnan(watch.load)


def test_a_slip_uses_up_the_time_to_react_even_across_intervals(grasp):
    contacts, watch = grasp[1], SlipWatch()
    slips = np.array([int(Grip.STICK), int(Grip.SLIP), int(Grip.STICK)])
    for tick in range(31):
        if tick == 10:
            watch.clear()
        note(watch, tick * MS, contacts, grip=slips)
    assert watch.evidence == 0.0
    assert watch.time_left == pytest.approx(REACTION - 0.030)
    note(watch, 40 * MS, contacts)
    watch.clear()
    note(watch, 41 * MS, contacts, grip=slips)
    assert watch.time_left == pytest.approx(REACTION)


def test_unknown_is_not_well(grasp):
    watch = SlipWatch()
    note(watch, 0, grasp[1], grip=LOOSE)
    assert np.isnan(watch.evidence) and np.isnan(watch.cone)
