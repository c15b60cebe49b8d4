# SPDX-License-Identifier: Apache-2.0
"""Fingers whose skin fails while they press: the joints replace it as long as they keep still."""

import numpy as np
import pytest
from support.controllers import REST, Bench

from tactile_hand_ros.control.contact import hand_jacobian, in_palm, joint_torques
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.grasp import grasp_map
from tactile_hand_ros.control.sensing import UnfeltTouch

FORCES = np.array([[0.3, 4.0, -0.2], [0.1, 2.5, 0.6], [-0.4, 3.0, 0.5]])
NONE, FIRST = np.zeros(3, dtype=bool), np.array([True, False, False])
FEELS = {"law__observer__time": 0.02, "touch_latency": 0.0}
IDENTITIES = np.tile(np.eye(3), (3, 1, 1))


def carried(bench, theta, twist):
    """Return joint angles after a small motion of the object, and its contacts with them."""
    hand, points = bench.controller.hand, bench.contacts.positions
    levers = hand_jacobian(hand.fingertips(theta), points, IDENTITIES).reshape(9, 9)
    return theta + np.linalg.solve(levers, grasp_map(points - bench.centroid, IDENTITIES).T @ twist)


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
    touch = UnfeltTouch(bench.controller.hand)
    touch.feel(bench.theta, bench.contacts)
    theta, twist = bench.theta, np.array([2e-4, -1e-4, 1e-4, 4e-4, 8e-4, -6e-4])
    for _ in range(100):
        theta = carried(bench, theta, twist)
        filled, _ = touch.filled(theta, bench.contacts, None, FIRST, REST)
    # It rolls on, so only about: 16 mm from the start, and turned by 0.1 rad.
    assert np.linalg.norm(filled.positions[0] - bench.contacts.positions[0]) > 0.01
    gap = filled.positions[0] - bench.controller.hand.fingertips(theta).positions[0]
    assert np.linalg.norm(gap) == pytest.approx(bench.controller.hand.radii[0], rel=1e-3)
    np.testing.assert_array_equal(filled.positions[1:], bench.contacts.positions[1:])


def test_its_force_is_that_of_its_torques():
    bench = Bench()
    hand, touch = bench.controller.hand, UnfeltTouch(bench.controller.hand)
    assert touch.filled(bench.theta, bench.contacts, FORCES, FIRST, REST) is None  # not yet felt
    touch.feel(bench.theta, bench.contacts)
    press = in_palm(bench.contacts.rotations, FORCES, 1.0)
    torque = joint_torques(*hand.fingertips(bench.theta), bench.contacts.positions, press)
    measured = np.where(FIRST[:, None], 7.0, FORCES)
    _, forces = touch.filled(bench.theta, bench.contacts, measured, FIRST, torque)
    np.testing.assert_allclose(forces, FORCES, atol=1e-9)
    assert touch.filled(bench.theta, bench.contacts, FORCES, ~NONE, torque) is None


@pytest.mark.parametrize("finger", range(3))
def test_the_wrong_force_of_one_finger_is_replaced_and_only_its_touch_rejected(finger):
    bench = Bench(**FEELS)
    hand = bench.controller.hand
    press = in_palm(bench.contacts.rotations, FORCES, 1.0)
    torque = joint_torques(*hand.fingertips(bench.theta), bench.contacts.positions, press)
    applied = torque + hand.gravity_torque(bench.theta)
    good = bench.step(400, forces=FORCES, applied=applied).torque
    wrong = np.where(np.arange(3)[:, None] == finger, -FORCES, FORCES)
    found = bench.step(400, forces=wrong, applied=applied)
    assert found.mode is Mode.DRIVE and not found.do_not_send
    np.testing.assert_array_equal(bench.controller.touch_rejected, np.arange(3) == finger)
    np.testing.assert_allclose(found.torque, good, atol=1e-6)
    bench.step(50, forces=FORCES, applied=applied)
    assert not bench.controller.touch_rejected.any()
    assert bench.step(50, forces=-FORCES, applied=applied).mode is Mode.HOLD
    assert bench.controller.touch_rejected.all()
