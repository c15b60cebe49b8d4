# SPDX-License-Identifier: Apache-2.0
"""If joints, contacts and f* contradict each other, the controller holds."""

import numpy as np
import pytest
from support.controllers import Bench
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.plausibility import (
    InputCheck,
    Tolerances,
    implausible_shape,
    implausible_touch,
)

PLANT = plant()
STATE, HAND = PLANT.state, PLANT.hand
STILL = np.zeros(9)


def shifted(*shift):
    return Contacts(STATE.contacts.positions + np.array(shift), STATE.contacts.rotations)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda _: {"theta": STATE.theta + 0.2}, "off its fingertip"),
        (lambda _: {"contacts": shifted(0.02, 0.0, 0.0)}, "20 mm off its fingertip"),
        (lambda b: {"optimal_forces": b.optimal[:, [1, 0, 2]]}, "normal parts"),
        (lambda b: {"optimal_forces": 3.0 * b.optimal}, "add up to 3 instead of 1"),
    ],
)
def test_what_does_not_fit_is_answered_with_the_grasp_force_that_was_there(wrong, reason):
    bench = Bench(touch_tolerance=0.0)
    before, held, after = bench.step(), bench.step(**wrong(bench)), bench.step()
    assert before.mode is Mode.DRIVE and held.mode is Mode.HOLD and reason in held.reason
    np.testing.assert_allclose(held.torque, before.torque, atol=1e-9)
    assert after.mode is Mode.DRIVE


def test_what_fits_within_the_tolerance_drives():
    bench = Bench(touch_tolerance=0.0)
    moved = {"theta": STATE.theta + 0.01, "contacts": shifted(0.002, 0.0, 0.0)}
    assert [bench.step(**given).mode for given in ({}, moved, {})] == [Mode.DRIVE] * 3


RADII = np.array([0.03, 0.06, 0.05])


@pytest.mark.parametrize("finger", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_contact_lies_its_own_radius_from_its_fingertip_along_its_normal(finger, sign):
    """The largest deviation counts, in any direction, up to the exact limit."""
    tips = HAND.fingertips(STATE.theta)
    on = tips.positions + RADII[:, None] * STATE.contacts.normals
    off = 0.004 * np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0], [0.8, 0.6, 0.0]])
    off[finger] *= sign * 2.5
    within, contacts = (Contacts(on + s * off, STATE.contacts.rotations) for s in (0.999, 1.001))
    assert implausible_touch(tips, within, RADII, np.full(3, 0.01)) is None
    found = implausible_touch(tips, contacts, RADII, np.full(3, 0.01))
    assert "10 mm off its fingertip" in found.reason
    np.testing.assert_array_equal(found.fingers, np.arange(3) == finger)
    exact = Contacts(on, STATE.contacts.rotations)
    assert implausible_touch(tips, exact, RADII, np.full(3, 1e-12)) is None
    small = np.where(np.arange(3) == finger, 1e-3, 1.0)  # each has its own
    assert (
        implausible_touch(tips, contacts, RADII, small)
        and implausible_touch(tips, contacts, RADII, small[[1, 2, 0]] + 1e-2) is None
    )


def test_the_normal_parts_of_f_add_up_to_one_within_a_thousandth():
    for total, fits in ((0.9989, False), (0.9991, True), (1.0009, True), (1.0011, False)):
        forces = np.array([[9.0, 0.5, 1.0], [2.0, 0.75, -3.0], [0.0, total - 1.25, 4.0]])
        assert (implausible_shape(forces) == "") == fits
    assert implausible_shape(np.full((3, 3), np.nan))


def test_contacts_may_creep_half_the_tolerance_from_where_the_joints_stopped():
    """By default a twelfth of the radius of their fingertips, 5 mm here."""
    for sign in (1.0, -1.0):
        for limits, step in (
            (Tolerances(0.004, 0.3, 0.0), 0.9e-3),
            (Tolerances(0.0, 0.3, 0.0), 2.2e-3),
        ):
            watch, found = InputCheck(HAND), []
            for i in range(4):
                seen = STATE.theta, STILL, shifted(0, 0, sign * step * i), limits, None
                found.append(watch.step(i, *seen)[1])
            assert found[:3] == [None] * 3 and "do not change" in found[3].reason
            assert found[3].fingers.all()  # nothing shows which finger is wrong
