# SPDX-License-Identifier: Apache-2.0
"""If inputs contradict each other, the controller holds: for how long, and what it forgets."""

import numpy as np
import pytest
from support.controllers import FEELING, REST, TICK, Bench
from support.grasps import FORCES
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Mode
from tactile_hand_ros.control.plausibility import (
    InputCheck,
    Tolerances,
    implausible_shape,
    implausible_touch,
)
from tactile_hand_ros.errors import PoseError

PLANT = plant()
STATE, HAND = PLANT.state, PLANT.hand


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
    assert implausible_touch(tips, contacts, RADII, small)
    assert implausible_touch(tips, contacts, RADII, small[[1, 2, 0]] + 1e-2) is None


def test_the_normal_parts_of_f_add_up_to_one_within_a_thousandth():
    for total, fits in ((0.9989, False), (0.9991, True), (1.0009, True), (1.0011, False)):
        forces = np.array([[9.0, 0.5, 1.0], [2.0, 0.75, -3.0], [0.0, total - 1.25, 4.0]])
        assert (implausible_shape(forces) == "") == fits
    assert implausible_shape(np.full((3, 3), np.nan))


def test_contacts_may_creep_half_the_tolerance_from_where_the_joints_stopped():
    """By default a twelfth of the radius of their fingertips, 5 mm here."""
    for sign in (1.0, -1.0):
        for tolerance, step in ((0.004, 0.9e-3), (0.0, 2.2e-3)):
            watch, limits, found = InputCheck(HAND), Tolerances(tolerance, 0.3, 0.0), []
            for i in range(4):
                seen = STATE.theta, REST, shifted(0, 0, sign * step * i), limits, None
                found.append(watch.step(i, *seen)[1])
            assert found[:3] == [None] * 3 and "do not change" in found[3].reason
            assert found[3].fingers.all()  # nothing shows which finger is wrong


DO_NOT_FIT = "forces and joint torques do not fit"


def touch(bench, share=1.0):
    """Return measured forces, and the torques of a fraction of them."""
    return {"forces": FORCES, "applied": bench.pressing(share * FORCES)}


def doubting(**values):
    """Return a controller that has just doubted the measured forces for the first time."""
    bench = Bench(**FEELING, **values)
    bench.step(5, **touch(bench))
    bench.step(**touch(bench, 0.0))
    return bench


def test_forces_are_compared_with_torques_where_they_decide_what_the_hand_does():
    bench = Bench(**FEELING)
    drive = bench.step(5, **touch(bench))
    assert drive.mode is Mode.DRIVE and not drive.do_not_send
    held = bench.step(2, **touch(bench, 0.0))
    assert held.mode is Mode.HOLD and DO_NOT_FIT in held.reason and held.pose is None
    for bench in (Bench(), Bench(**FEELING, force_tolerance=0.0)):
        assert bench.step(3, **touch(bench, 0.0)).mode is Mode.DRIVE
    bench = Bench(**FEELING)
    for one in touch(bench, 0.0).items():  # one of the two alone proves nothing
        assert bench.step(3, **dict([one])).mode is Mode.DRIVE


def test_the_tolerance_of_the_forces_is_the_configured_one():
    modes = []
    for tolerance in (0.1, 0.5):
        bench = Bench(**FEELING, force_tolerance=tolerance)
        modes.append(bench.step(60, **touch(bench, 0.75)).mode)
    assert modes == [Mode.HOLD, Mode.DRIVE]


def test_a_doubtful_input_is_answered_by_the_guard_at_first_and_after_half_a_second_from_here():
    bench = doubting()
    doubted = bench.stamp - TICK
    for late, do_not_send in ((0.002, True), (0.498, True), (0.5, False), (7.0, False)):
        bench.stamp = doubted + round(1e9 * late)
        held = bench.step(**touch(bench, 0.0))
        assert held.mode is Mode.HOLD and held.do_not_send == do_not_send
    bench.controller.joints_held = True
    assert bench.step(**touch(bench, 0.0)).do_not_send
    bench.controller.joints_held = False
    assert not bench.step(**touch(bench, 0.0)).do_not_send


@pytest.mark.parametrize("end", ["a good tick", "forget"])
def test_the_time_of_implausible_inputs_restarts_after_their_end(end):
    bench = Bench(grasp_force_limit=12.0, input_timeout=0.1)
    bench.step()
    assert bench.step(grasp_force=13.0).do_not_send
    bench.stamp += 50 * TICK
    assert not bench.step(grasp_force=13.0).do_not_send
    if end == "forget":
        bench.controller.forget()
    else:
        assert bench.step().mode is Mode.DRIVE
    assert bench.step(grasp_force=13.0).do_not_send


def retake(bench):
    bench.controller.release()
    bench.step()
    bench.controller.grasp()
    assert bench.step().mode is Mode.DRIVE


@pytest.mark.parametrize(
    "end", [retake, lambda b: b.step(contacts=b.nowhere), lambda b: b.controller.forget()]
)
def test_what_was_pressed_before_another_grasp_is_forgotten(end):
    """The force averages restart; the old ones would outweigh the new, consistent forces."""
    bench = doubting()
    bench.step(50, **touch(bench, 0.0))
    end(bench)
    assert [bench.step(**touch(bench)).mode for _ in range(3)] == [Mode.DRIVE] * 3


def test_a_grasp_force_is_accepted_up_to_its_limit():
    bench = Bench(grasp_force_limit=12.0)
    left = np.linspace(-0.4, 0.6, 9)  # by the controller before
    np.testing.assert_allclose(bench.step(grasp_force=13.0, applied=left).torque, left, atol=1e-12)
    drive = bench.step(grasp_force=12.0)
    assert drive.mode is Mode.DRIVE
    held = bench.step(grasp_force=np.nextafter(12.0, 13.0))
    assert held.mode is Mode.HOLD and held.do_not_send
    assert held.reason == "k_f = 12 N is above grasp_force_limit = 12 N; holding until it is not"
    np.testing.assert_allclose(held.torque, drive.torque, atol=1e-12)  # and not raised by it
    assert Bench().step(grasp_force=1e6).mode is Mode.DRIVE


def test_a_held_grasp_force_rises_as_far_as_the_joints_can_bear_and_keeps_its_shape():
    bench = Bench(gravity_compensation=True)
    hand = bench.controller.hand
    limits, weight = hand.effort_limits, hand.gravity_torque(bench.theta)
    force = bench.step().torque - weight
    given = bench.step(contacts=bench.nowhere, grasp_force=1e4).torque
    assert np.abs(given / limits).max() == pytest.approx(1.0)
    share = (given - weight) @ force / (force @ force)
    assert share > 3.0
    np.testing.assert_allclose(given - weight, share * force, atol=1e-9)


def test_the_grasp_force_comes_before_the_drive_and_that_before_the_damping():
    """Each is reduced as a whole, except the damping, which is limited per joint."""
    limits = Bench().controller.hand.effort_limits
    rates = np.linspace(-1.0, 1.5, 9)

    def torque(force, k_p=1e-12, damping=1e-12):
        bench = Bench(law__k_p=k_p, law__k_o=1e-12, law__damping=damping)
        bench.controller.targets.command(bench.target(0.0, 0.0, 0.03))
        return bench.step(rates=rates, grasp_force=force).torque

    force, drive = torque(40.0), torque(0.0, 250.0)
    assert np.abs(force / limits).max() < 1.0
    pressed, wanted = torque(40.0, 1e4), 40.0 * drive
    assert np.abs(wanted + force).max() > limits.max()
    moved = pressed - force
    fraction = moved @ wanted / (wanted @ wanted)
    assert 0.0 < fraction < 1.0
    np.testing.assert_allclose(moved, fraction * wanted, atol=1e-9)
    assert np.abs(pressed / limits).max() == pytest.approx(1.0)
    damped = torque(40.0, 1e4, damping=30.0)
    np.testing.assert_allclose(damped, np.clip(pressed - 30.0 * rates, -limits, limits), atol=1e-9)


def test_one_pose_is_judged_in_a_tick_or_a_silence():
    bench = Bench()
    bench.step()
    far = bench.target(0.0, 0.0, 2.0)
    for following in (bench.step, bench.hold):
        with pytest.raises(PoseError):
            bench.controller.targets.command(far)
        bench.controller.targets.command(far)
        bench.controller.targets.forget_after(-1)
        following()
    with pytest.raises(PoseError):
        bench.controller.targets.command(far)
