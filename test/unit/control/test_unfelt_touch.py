# SPDX-License-Identifier: Apache-2.0
"""Fingers whose skin fails while they press: the joints replace it as long as they keep still."""

import numpy as np
import pytest
from support.controllers import FEELING, REST, Bench
from support.grasps import FORCES, contacts_at
from support.hands import write_hand

from tactile_hand_ros.control.contact import Contacts, hand_jacobian, in_palm, joint_torques
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.grasp import grasp_map
from tactile_hand_ros.control.sensing import LateTouch, UnfeltTouch
from tactile_hand_ros.hand.hand import Hand

NONE, FIRST = np.zeros(3, dtype=bool), np.array([True, False, False])
STEADY = np.linspace(-0.5, 0.7, 9)
IDENTITIES = np.tile(np.eye(3), (3, 1, 1))


def inward(bench, finger, distance):
    """Return joint angles with the tip of a finger moved along its normal, m."""
    hand = bench.controller.hand
    levers = hand.fingertips(bench.theta).linear.reshape(9, 9)
    shift = np.zeros((3, 3))
    shift[finger] = distance * bench.contacts.normals[finger]
    return bench.theta + np.linalg.solve(levers, shift.ravel())


@pytest.mark.parametrize("finger", range(3))
def test_a_finger_that_stays_presses_on_unfelt_and_one_that_leaves_its_place_does_not(finger):
    """Its distance from another may change by a sixth of the radius of a tip, 10 mm here."""
    for distance, mode in ((-9e-3, Mode.DRIVE), (9e-3, Mode.DRIVE), (15e-3, Mode.HOLD)):
        bench = Bench()
        felt = bench.step()
        unfelt = bench.step(contacts=bench.without_finger(finger), optimal_forces=np.nan * FORCES)
        np.testing.assert_allclose(unfelt.torque, felt.torque, atol=1e-9)
        assert f"no usable touch at finger_{finger + 1}" in bench.controller.missing
        for part in np.linspace(0.1, 1.0, 10):
            lost = {"theta": inward(bench, finger, part * distance)}
            found = bench.step(contacts=bench.without_finger(finger), **lost)
        assert found.mode is mode
        assert ("no contact at" in found.reason) == (mode is Mode.HOLD)
        again = bench.step()
        assert again.mode is Mode.DRIVE and bench.controller.missing == ""


def test_the_contact_of_an_unfelt_finger_moves_with_the_object():
    bench = Bench()
    hand, points, theta = bench.controller.hand, bench.contacts.positions, bench.theta
    touch, twist = UnfeltTouch(hand), np.array([2e-4, -1e-4, 1e-4, 4e-4, 8e-4, -6e-4])
    touch.feel(theta, bench.contacts, FORCES)
    shifts = grasp_map(points - bench.centroid, IDENTITIES).T @ twist
    for _ in range(100):
        levers = hand_jacobian(hand.fingertips(theta), points, IDENTITIES).reshape(9, 9)
        theta = theta + np.linalg.solve(levers, shifts)
        filled, _ = touch.filled(theta, bench.contacts, None, FIRST, REST)
    # It rolls on, so only about: 16 mm from the start, and turned by 0.1 rad.
    assert np.linalg.norm(filled.positions[0] - points[0]) > 0.01
    gap = filled.positions[0] - hand.fingertips(theta).positions[0]
    assert np.linalg.norm(gap) == pytest.approx(hand.radii[0], rel=1e-3)
    np.testing.assert_array_equal(filled.positions[1:], points[1:])


def test_its_force_is_that_of_its_torques():
    bench = Bench()
    hand, touch = bench.controller.hand, UnfeltTouch(bench.controller.hand)
    assert touch.filled(bench.theta, bench.contacts, FORCES, FIRST, REST) is None  # not yet felt
    touch.feel(bench.theta, bench.contacts, FORCES)
    torque = bench.pressing() - hand.gravity_torque(bench.theta)
    measured = np.where(FIRST[:, None], 7.0, FORCES)
    _, forces = touch.filled(bench.theta, bench.contacts, measured, FIRST, torque)
    np.testing.assert_allclose(forces, FORCES, atol=1e-9)
    assert touch.filled(bench.theta, bench.contacts, FORCES, ~NONE, torque) is None


def pressed(tmp_path, joints, theta):
    """Return an `UnfeltTouch` for such fingers, their tips, contacts, and the torque of FORCES."""
    hand = Hand.load(str(write_hand(tmp_path, joints)))
    tips = hand.fingertips(theta)
    normals = tips.positions.mean(axis=0) - tips.positions
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    contacts = contacts_at(tips.positions + hand.radii[:, None] * normals, normals)
    press = in_palm(contacts.rotations, FORCES, 1.0)
    return UnfeltTouch(hand), tips, contacts, joint_torques(tips, contacts.positions, press)


def test_what_a_straight_finger_does_not_show_is_not_made_up_from_its_noise(tmp_path):
    theta = np.array([0.3, 0.0, 1e-3, 0.1, 0.4, 0.8, -0.1, 0.5, 0.7])
    touch, _, contacts, torque = pressed(tmp_path, [3, 3, 3], theta)
    torque[:3] += [0.02, -0.02, 0.02]
    touch.feel(theta, contacts, FORCES)
    _, forces = touch.filled(theta, contacts, FORCES, FIRST, torque)
    assert 0.01 < np.abs(forces - FORCES).max() < 1.0


def test_what_the_torques_of_two_joints_do_not_show_stays_as_it_was_felt(tmp_path):
    theta = np.array([0.3, 0.9, 0.1, 0.4, 0.8, -0.1, 0.5, 0.7])
    touch, tips, contacts, torque = pressed(tmp_path, [2, 3, 3], theta)
    touch.feel(theta, contacts, FORCES + [[0.4, -0.7, 0.9], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    _, forces = touch.filled(theta, contacts, FORCES, ~FIRST, torque)
    np.testing.assert_allclose(forces, FORCES, atol=1e-9)
    _, forces = touch.filled(theta, contacts, FORCES, FIRST, torque)
    levers = hand_jacobian(tips, contacts.positions, contacts.rotations)[0]
    changed = forces[0] - FORCES[0] - [0.4, -0.7, 0.9]
    assert np.abs(forces[0] - FORCES[0]).max() > 0.1
    np.testing.assert_allclose(levers.T @ (forces[0] - FORCES[0]), 0.0, atol=1e-9)
    hidden = np.cross(*np.linalg.svd(levers.T)[2][:2])
    assert changed @ hidden == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("finger", range(3))
@pytest.mark.parametrize("fault", ["force", "motor"])
def test_where_force_and_torque_of_one_finger_disagree_only_its_touch_is_rejected(finger, fault):
    """The sent torques count, whichever of the two is wrong."""
    bench, spoiled = Bench(**FEELING), np.arange(3) == finger
    good = {"forces": FORCES, "applied": bench.pressing()}
    bench.step(50, **good)
    wrong = {"forces": np.where(spoiled[:, None], -FORCES, FORCES)}
    if fault == "motor":
        moved = spoiled @ bench.controller.hand.moves > 0
        wrong = {"applied": np.where(moved, 0.0, good["applied"])}
    found = bench.step(5, **good | wrong)
    assert found.mode is Mode.DRIVE and not found.do_not_send
    np.testing.assert_array_equal(bench.controller.touch_rejected, spoiled)
    bench.step(50, **good)
    assert not bench.controller.touch_rejected.any()
    every = {"forces": -FORCES} if fault == "force" else {"applied": 0.0 * good["applied"]}
    assert bench.step(50, **good | every).mode is Mode.HOLD
    assert bench.controller.touch_rejected.all()


def test_the_value_of_a_rejected_force_has_no_effect():
    shown, spoiled = [], (np.arange(3) == 1)[:, None]
    for value in (-5.0, 9.0):
        bench = Bench(**FEELING)
        good = {"forces": FORCES, "applied": bench.pressing()}
        bench.step(50, **good)
        found = bench.step(5, **good | {"forces": np.where(spoiled, value, FORCES)})
        shown.append(found.torque)
        assert bench.controller.touch_rejected[1]
    np.testing.assert_array_equal(*shown)


def test_a_jolt_of_the_others_shows_that_a_contact_is_lost():
    """Its touch is not rejected, so that the regulator still follows what the others carry."""
    bench = Bench(gravity_compensation=True, **FEELING)
    forces = bench.grasp_force * bench.optimal
    good = {"forces": forces, "applied": bench.pressing(forces)}
    bench.step(50, **good)
    lost = {**good, "contacts": bench.without_finger(0)}
    calm, jolted = (lost | {"forces": forces * [[0.0], [s], [s]]} for s in (1.0, 9.0))
    assert bench.step(50, **calm).mode is Mode.DRIVE
    assert bench.step(5, **jolted).mode is Mode.HOLD
    assert not bench.controller.touch_rejected.any()
    assert bench.step(50, **calm).mode is Mode.HOLD
    assert bench.step(50, **good).mode is Mode.DRIVE


@pytest.mark.parametrize("dead", [0.0, np.nan])
def test_a_hold_does_not_end_it_nor_does_a_skin_without_numbers(dead):
    bench = Bench(**FEELING)
    bench.step(50, forces=FORCES)
    forces = FORCES.copy()
    forces[0] = dead
    unfelt = {"contacts": bench.without_finger(0), "forces": forces}
    assert bench.step(5, **unfelt).mode is Mode.DRIVE
    bench.hold()
    found = bench.step(5, **unfelt)
    assert found.mode is Mode.DRIVE and np.isfinite(found.torque).all()


def test_repeated_samples_of_the_others_stay_old_while_a_contact_is_filled_in():
    bench = Bench()
    hand, late = bench.controller.hand, LateTouch(bench.controller.hand)
    rest = STEADY, hand.fingertips(bench.theta)
    seen = [late.step(0, bench.theta, *rest, bench.contacts, ~NONE, 0.002, 0.015, 0.0)]
    for tick in range(1, 3):
        moved = bench.contacts.positions + 1e-4 * tick * FIRST[:, None]
        contacts = Contacts(moved, bench.contacts.rotations)
        theta = bench.theta + 0.002 * tick * STEADY
        seen.append(late.step(2_000_000 * tick, theta, *rest, contacts, ~FIRST, 0.002, 0.015, 0.0))
    np.testing.assert_allclose(seen, np.outer([0.0, 0.002, 0.004], STEADY), atol=1e-12)
