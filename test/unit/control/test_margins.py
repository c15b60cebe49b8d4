# SPDX-License-Identifier: Apache-2.0
"""Margins of A1 to A7 on the paper's grasp and its violations."""

import numpy as np
import pytest
from support.equations import hand_jacobian
from support.grasps import contacts_at
from support.hands import write_hand
from support.plants import plant

from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.control.margins import REACTION, GraspMonitor, SlipMonitor, angles_between
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.hand.hand import Hand

MS = 1_000_000
HOLDS = np.array([[0.2, 1.0, 0.1], [0.0, 2.0, 0.4], [0.3, 1.0, 0.0]])
STICK, LOOSE = np.full(3, int(ContactState.STICK)), np.full(3, int(ContactState.UNKNOWN))
SLIP = int(ContactState.SLIP)
MU = np.array([0.5, 0.35, 0.8])
INSIDE = np.array([0.5 - np.hypot(0.2, 0.1), 0.3, 0.5])  # mu f_n - |f_t| of them
POSTURE = np.array([1.2, 0.1, 1.3, 0.9, -0.2, 1.6, 1.0, 0.3, 1.1])
RADII = np.array([0.03, 0.06, 0.05])
STATE = plant().state


def note(watch, stamp, grip=STICK, evidence=0.1, forces=HOLDS):
    evidence = np.broadcast_to(evidence, 3).copy()
    watch.note(stamp, STATE.contacts, forces, MU, grip, evidence)


@pytest.fixture(scope="module")
def hand():
    """Return a hand with different fingertips."""
    config = load_hand_config("paper")
    fingers = zip(config.fingers, RADII, strict=True)
    changed = [finger.model_copy(update={"radius": float(r)}) for finger, r in fingers]
    return Hand(config.model_copy(update={"fingers": changed}))


def leaning(hand, theta, angles):
    """Return contacts whose normals lean by an angle from the axis of their fingertip."""
    ways = np.array([0.4, 2.5, -1.2])  # around the tip
    sides = np.array([0.0 * ways, np.cos(ways), np.sin(ways)]).T
    local = np.cos(angles)[:, None] * [1.0, 0.0, 0.0] + np.sin(angles)[:, None] * sides
    tips, centers = hand.tip_rotations(theta), hand.tip_positions(theta)
    normals = np.array([tip @ n for tip, n in zip(tips, local, strict=True)])
    return contacts_at(centers + RADII[:, None] * normals, normals)


def test_the_papers_grasp_is_far_from_every_edge():
    theta, contacts, hand = STATE.theta, STATE.contacts, Hand.load("paper")
    margins = GraspMonitor(hand).margins(theta, contacts)
    # The last links point 30 degrees above the horizontal.
    assert margins.hemisphere == pytest.approx(np.radians(60.0), abs=2e-3)
    assert margins.face_travel == 0.0
    jacobian = hand_jacobian(*hand.fingertips(theta), contacts.positions)
    assert 0.05 < margins.joint == pytest.approx(np.linalg.svd(jacobian, compute_uv=False)[-1])
    extents = np.linalg.svd(contacts.positions - contacts.centroid, compute_uv=False)
    assert 0.5 < margins.collinearity == pytest.approx(extents[1] / extents[0])


@pytest.mark.parametrize("worst", range(3))
def test_the_contact_nearest_to_the_rim_of_its_tip_counts(hand, worst):
    angles = np.roll([1.3, 0.8, 0.4], worst)
    margins = GraspMonitor(hand).margins(POSTURE, leaning(hand, POSTURE, angles))
    assert margins.hemisphere == pytest.approx(0.5 * np.pi - 1.3)
    beyond = GraspMonitor(hand).margins(POSTURE, leaning(hand, POSTURE, angles + 0.4))
    assert beyond.hemisphere == pytest.approx(0.5 * np.pi - 1.7)


@pytest.mark.parametrize(
    ("moved", "travel"),
    [([0.3, 0.1, 0.1], 9e-3), ([0.3, 0.2, 0.1], 12e-3), ([0.1, 0.1, 0.2], 1e-2)],
)
def test_the_longest_way_over_a_tip_counts_whatever_the_posture(hand, moved, travel):
    """The arc has the tip's own radius; a contact that turns with its finger does not travel."""
    angles, watch = np.array([0.6, 0.3, 0.9]), GraspMonitor(hand)
    bent = POSTURE + [0.1, -0.3, 0.2, 0.0, 0.2, -0.1, 0.3, 0.1, -0.2]
    watch.margins(POSTURE, leaning(hand, POSTURE, angles))
    still = watch.margins(bent, leaning(hand, bent, angles)).face_travel
    assert still == pytest.approx(0.0, abs=1e-8)
    away = leaning(hand, bent, angles + moved)
    assert watch.margins(bent, away).face_travel == pytest.approx(travel)
    watch.reset()
    assert watch.margins(bent, away).face_travel == pytest.approx(0.0, abs=1e-8)


def test_travel_counts_from_the_first_contacts_until_one_is_lost(hand):
    first = leaning(hand, POSTURE, np.array([0.6, 0.3, 0.9]))
    later = leaning(hand, POSTURE, np.array([0.6, 0.4, 0.9]))
    watch = GraspMonitor(hand)
    watch.margins(POSTURE, first)
    assert watch.margins(POSTURE, later).face_travel == pytest.approx(0.1 * RADII[1])
    lost = watch.margins(POSTURE, later.without(np.arange(3) == 1))
    assert lost.collinearity == 0.0 and np.isnan(lost.hemisphere)
    assert watch.margins(POSTURE, later).face_travel == pytest.approx(0.0, abs=1e-8)


def test_of_four_fingers_three_are_watched_while_one_is_missing(tmp_path):
    hand = Hand.load(str(write_hand(tmp_path, [3, 4, 3, 3])))
    theta = 0.5 + 0.03 * np.arange(hand.joints)
    normals = hand.tip_rotations(theta)[:, :, 0]
    points = hand.tip_positions(theta) + hand.radii[:, None] * normals
    whole, touching = contacts_at(points, normals), np.arange(4) != 1
    parted, bent = whole.without(~touching), theta + 0.05 * np.sin(np.arange(hand.joints))
    bent[3:7] += 0.3  # the joints of the missing finger
    watch, others = GraspMonitor(hand), GraspMonitor(hand.part(touching))
    watch.margins(theta, whole)
    others.margins(theta, parted.part(touching))
    apart = watch.margins(bent, parted)
    assert apart == others.margins(bent, parted.part(touching))
    # The arc of a new contact starts here; those of the others continue.
    assert watch.margins(bent, whole).face_travel == apart.face_travel > 0.0


def test_the_worst_of_an_interval_is_reported_and_a_new_one_starts():
    watch = SlipMonitor()
    note(watch, 0)
    note(watch, MS, evidence=[0.1, 0.7, 0.2], forces=0.5 * HOLDS)
    note(watch, 2 * MS)
    assert watch.evidence == pytest.approx(0.3)
    assert watch.cone == pytest.approx(0.5 * INSIDE.min())
    assert watch.time_left == REACTION
    watch.clear()
    assert np.isnan(watch.evidence) and np.isnan(watch.cone) and np.isnan(watch.load)


def test_the_load_is_the_largest_net_force():
    """Internal forces cancel only if each force is rotated out of its contact frame."""
    watch, frames = SlipMonitor(), STATE.contacts.rotations
    for scale in (0.5, 1.0, 0.7):
        note(watch, 0, forces=scale * HOLDS)
    assert watch.load == pytest.approx(np.linalg.norm(np.einsum("kij,kj->i", frames, HOLDS)))
    watch.clear()
    note(watch, MS, forces=np.einsum("kji,kj->ki", frames, np.eye(3) - 1 / 3))
    assert watch.load == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("finger", range(3))
def test_each_contact_is_judged_by_its_own_friction_and_evidence(finger):
    known = np.where(np.arange(3) == finger, STICK, LOOSE)
    watch, evidence = SlipMonitor(), np.array([0.2, 0.5, 0.9])
    note(watch, 0, grip=known, evidence=evidence)
    assert watch.cone == pytest.approx(INSIDE[finger])
    assert watch.evidence == pytest.approx(1.0 - evidence[finger])
    slips = np.where(known == ContactState.STICK, SLIP, known)
    note(watch, MS, grip=slips)
    assert watch.evidence == 0.0 and watch.cone == pytest.approx(INSIDE[finger])
    note(watch, 11 * MS, grip=slips)
    assert watch.time_left == pytest.approx(REACTION - 0.010)


def test_a_slip_uses_up_the_time_to_react_even_across_intervals():
    watch = SlipMonitor()
    slips = np.where(np.arange(3) == 1, SLIP, STICK)
    note(watch, 0, grip=slips)
    watch.clear()
    note(watch, 30 * MS, grip=slips)
    assert watch.time_left == pytest.approx(REACTION - 0.030)
    note(watch, 40 * MS)
    note(watch, 41 * MS, grip=slips)
    assert watch.time_left == pytest.approx(REACTION - 0.030)  # the longest of the interval
    watch.clear()
    note(watch, 46 * MS, grip=slips)
    assert watch.time_left == pytest.approx(REACTION - 0.005)
    watch.clear()
    assert watch.time_left == REACTION == 0.02 and np.isnan(watch.load)


def test_rounding_beyond_opposite_and_equal_directions_is_no_angle():
    longer = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]]) * (1.0 + 1e-12)
    np.testing.assert_array_equal(angles_between(longer, -longer), np.pi)
    np.testing.assert_array_equal(angles_between(longer, longer), 0.0)
