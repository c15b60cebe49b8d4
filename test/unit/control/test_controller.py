# SPDX-License-Identifier: Apache-2.0
"""The controller: driving, holding, disabled, present and future targets, rejected commands."""

import math
from itertools import pairwise

import numpy as np
import pytest
from support.controllers import REST, TABLE_I, TICK, Bench
from support.grasps import FORCES, moved

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import ControllerConfig, Mode
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.holds import GraspTorque
from tactile_hand_ros.control.laws import OWN_LAWS, OptimalLaw, Target
from tactile_hand_ros.control.targets import MAX_WAITING
from tactile_hand_ros.errors import GraspError, PoseError
from tactile_hand_ros.rotations import rotation_from_quaternion, rotation_from_vector

EVERYTHING = {
    "law__integral__k_p": 20.0,
    "law__integral__k_o": 3.0,
    "law__observer__time": 0.02,
    "midpoint_hold": True,
    "reference_time": 0.05,
}


@pytest.fixture
def bench():
    return Bench()


def test_without_a_target_the_grasp_is_kept_where_it_was_first_seen(bench):
    first = bench.step()
    assert first.mode is Mode.DRIVE and first.reason == ""
    np.testing.assert_allclose(first.pose.position, bench.centroid)
    np.testing.assert_allclose(first.pose.orientation, np.eye(3), atol=1e-12)
    shifted = moved(bench.contacts, np.eye(3), np.array([0.01, 0.0, 0.0]))
    back = bench.step(contacts=shifted).torque - first.torque
    pulls = bench.controller.hand.fingertips(bench.theta).linear.sum(axis=0)
    assert (pulls @ back)[0] < 0.0 and np.linalg.norm(back) > 1e-3
    np.testing.assert_allclose(bench.controller.targets.target.position, bench.centroid)


def test_a_target_keeps_what_is_nan_as_the_grasp_is_when_it_takes_effect(bench):
    nothing, turn = np.full((3, 3), np.nan), rotation_from_vector([0.0, 0.0, 0.1])
    there = bench.centroid + [0.0, 0.0, 0.01]
    bench.controller.targets.command(Target(there, nothing), stamp=2 * TICK)
    bench.controller.targets.command(Target(np.full(3, np.nan), turn), stamp=4 * TICK)
    moved_on = bench.elsewhere(0.0, 0.002, 0.0, turn=(0.05, 0.0, 0.0))
    bench.step(2)
    pose = bench.step(2, contacts=moved_on).pose
    kept = bench.controller.targets.target
    np.testing.assert_array_equal(kept.position, there)
    np.testing.assert_array_equal(kept.orientation, rotation_from_quaternion(kept.quaternion))
    np.testing.assert_allclose(kept.orientation, pose.orientation, atol=1e-12)
    bench.step(contacts=moved_on)
    np.testing.assert_array_equal(bench.controller.targets.target.position, pose.position)
    np.testing.assert_array_equal(bench.controller.targets.target.orientation, turn)


def test_a_grasp_force_beyond_the_joints_keeps_its_shape(bench):
    """If a single joint saturated, it would distort the forces and throw the object."""
    wanted, limits = bench.step().torque, bench.controller.hand.effort_limits
    given = bench.step(grasp_force=400.0).torque
    assert np.abs(40.0 * wanted / limits).max() > 1.5
    assert np.abs(given / limits).max() == pytest.approx(1.0)
    np.testing.assert_allclose(given / np.linalg.norm(given), wanted / np.linalg.norm(wanted))


def test_of_several_targets_the_latest_due_one_counts(bench):
    bench.step(5)
    for shift, tick in ((0.03, 7), (0.04, 4), (0.01, 1), (0.02, 0)):
        bench.controller.targets.command(bench.target(shift, 0.0, 0.0), stamp=tick * TICK)
    wanted, accepted = [], []
    for _ in range(4):
        bench.step()
        wanted.append(bench.shift[0])
        accepted.append(bench.controller.targets.accepted)
    np.testing.assert_allclose(wanted, [0.02, 0.02, 0.03, 0.03], atol=1e-12)
    took = [target.position[0] - bench.centroid[0] if target else np.inf for target in accepted]
    np.testing.assert_allclose(took, [0.02, np.inf, 0.03, np.inf], atol=1e-12)


def test_of_too_many_waiting_targets_the_earliest_are_dropped_and_counted(bench):
    bench.step()
    targets = bench.controller.targets
    for tick in range(MAX_WAITING, 0, -1):
        targets.command(bench.target(1e-5 * tick, 0.0, 0.0), stamp=(tick + 2) * TICK)
    assert targets.dropped == 0
    for _ in range(2):
        targets.command(bench.target(0.03, 0.0, 0.0), stamp=10**6 * TICK)
    bench.stamp = 4 * TICK
    bench.step()  # the first two are gone
    np.testing.assert_array_equal(targets.target.position, bench.centroid)
    bench.step()
    np.testing.assert_allclose(bench.shift, [3e-5, 0.0, 0.0], atol=1e-12)
    bench.controller.reset()
    assert targets.dropped == 2


def test_targets_after_a_tick_can_be_forgotten(bench):
    bench.step()
    for tick in (7, 8, 9, 9):
        bench.controller.targets.command(bench.target(1e-3 * tick, 0.0, 0.0), stamp=tick * TICK)
    assert bench.controller.targets.forget_after(8 * TICK) == [9 * TICK, 9 * TICK]
    assert bench.controller.targets.forget_after(8 * TICK) == []
    bench.stamp = 20 * TICK
    bench.step()
    np.testing.assert_allclose(bench.shift, [8e-3, 0.0, 0.0], atol=1e-12)


def test_a_law_without_a_finite_torque_gives_the_hold(bench):
    good = bench.step()
    command = bench.step(rates=np.full(9, np.inf))
    assert command.mode is Mode.HOLD and "no finite torque" in command.reason
    np.testing.assert_allclose(bench.step().torque, good.torque, atol=1e-9)


def test_a_target_counts_also_if_the_law_fails_at_its_tick(bench):
    bench.step()
    bench.controller.targets.command(bench.target(0.01, 0.0, 0.0))
    assert bench.step(rates=np.full(9, np.inf)).mode is Mode.HOLD
    np.testing.assert_allclose(bench.shift, [0.01, 0.0, 0.0], atol=1e-12)
    assert bench.controller.targets.accepted is bench.controller.targets.target


def test_a_target_out_of_reach_is_refused_at_once_and_the_last_stays(bench):
    bench.controller.targets.command(bench.target(0.05, 0.0, 0.0))
    bench.step()
    with pytest.raises(PoseError, match=r"out of reach: finger_\d would stay \d+ mm short"):
        bench.controller.targets.command(bench.target(0.0, 0.0, 2.0))
    assert bench.step().reason == ""
    np.testing.assert_allclose(bench.shift, [0.05, 0.0, 0.0], atol=1e-12)
    bench.controller.targets.schedule(bench.target(0.0, 0.0, 2.0), 0, judged=False)
    assert "out of reach" in bench.step().reason


def test_a_move_ends_where_the_grasp_force_nears_its_limit():
    """The initial grasp force may be too low for the object at the end of a move."""
    bench = Bench(grasp_force_limit=20.0, reference_time=0.2)
    bench.step()
    target = bench.target(0.01, 0.0, 0.0)
    bench.controller.targets.command(target)
    assert not bench.step(100, grasp_force=15.9).reason
    assert "the move ends here: k_f = 16.1 N is near" in bench.step(grasp_force=16.1).reason
    stopped = bench.controller.targets.target
    np.testing.assert_array_equal(stopped.position, bench.centroid)
    assert not bench.step(500, grasp_force=10.0).reason
    assert bench.controller.targets.target is stopped
    bench.controller.targets.command(target)
    assert not bench.step(2000).reason  # it may be requested again
    assert not bench.step(grasp_force=19.0).reason  # and a target that was reached is kept
    assert bench.controller.targets.target is target


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (lambda b: {"contacts": b.nowhere}, "no contact at finger_1, finger_2, finger_3"),
        (lambda b: {"optimal_forces": np.full((3, 3), np.nan)}, "no optimal force"),
        (lambda b: {"optimal_forces": b.optimal + [[0], [0], [np.nan]]}, "no optimal force"),
        (lambda b: {"grasp_force": float("nan")}, "k_f = nan"),
        (lambda b: {"grasp_force": float("inf")}, "k_f = inf"),
        (lambda b: {"grasp_force": -1.0}, "k_f = -1.0"),
        (
            lambda b: {
                "contacts": Contacts(b.contacts.positions * [1, 0, 0], b.contacts.rotations)
            },
            "one line",
        ),
    ],
)
def test_what_is_missing_makes_it_hold_and_what_returns_makes_it_drive(given, reason):
    bench = Bench()
    drive = bench.step()
    held = bench.step(**given(bench))
    assert held.mode is Mode.HOLD and reason in held.reason
    # At rest at the target, the drive is only the grasp force, and holding keeps exactly that.
    np.testing.assert_allclose(held.torque, drive.torque, atol=1e-9)
    away = bench.theta + 0.01
    pushed = bench.step(theta=away, **given(bench)).torque
    back = -bench.stiffness(away) @ np.full(9, 0.01)
    tips = bench.controller.hand.fingertips  # with which the internal forces turn
    turned = GraspTorque.of(tips(bench.theta), held.torque).at(tips(away), 1.0)
    np.testing.assert_allclose(pushed, turned + back, atol=1e-9)
    rubbed = bench.step(rates=np.ones(9), **given(bench)).torque
    damping = 2.0 * 0.007 / 0.5 * bench.stiffness(bench.theta) @ np.ones(9)
    np.testing.assert_allclose(rubbed - held.torque, -damping, atol=1e-9)
    again = bench.step()
    assert again.mode is Mode.DRIVE
    np.testing.assert_allclose(again.torque, drive.torque, atol=1e-9)


def test_law_10_needs_no_optimal_force_and_a_grasp_force_may_be_zero():
    bench = Bench(law__name="contact")
    for forces in (np.full((3, 3), np.nan), 3.0 * bench.optimal):
        command = bench.step(optimal_forces=forces, grasp_force=0.0)
        assert command.mode is Mode.DRIVE
        np.testing.assert_allclose(command.torque, REST, atol=1e-12)


def test_a_second_hold_starts_from_its_own_posture(bench):
    bench.step()
    bench.hold()
    bench.step()
    there = bench.theta + 0.05
    drive = bench.step(theta=there)
    held = bench.hold(theta=there)
    assert held.reason == "silence" and held.mode is Mode.HOLD
    assert np.abs(held.torque - drive.torque).max() < 0.2  # no spring back to the first posture


def test_disabled_means_damping_only_and_enabled_drives_again(bench):
    drive = bench.step()
    bench.controller.enabled = False
    rates = np.linspace(-1.0, 1.0, 9)
    for command in (bench.step(rates=rates), bench.hold(rates=rates)):
        assert command.mode is Mode.DISABLED
        np.testing.assert_allclose(command.torque, -0.07 * rates, atol=1e-15)
    bench.controller.enabled = True
    np.testing.assert_allclose(bench.step().torque, drive.torque, atol=1e-9)


@pytest.mark.parametrize("silent", [False, True])
def test_after_disabling_a_hold_keeps_neither_the_old_grasp_force_nor_the_old_posture(silent):
    bench = Bench(law__observer__time=0.02)
    bench.step(10, forces=FORCES)
    bench.hold()
    bench.controller.enabled = False
    if silent:
        bench.hold()
    else:
        bench.step(forces=FORCES)
    bench.controller.enabled = True
    there = bench.theta + np.linspace(-0.3, 0.4, 9)
    held = bench.hold(theta=there, grasp_force=20.0)
    assert held.mode is Mode.HOLD
    np.testing.assert_array_equal(held.torque, REST)


def test_a_hold_keeps_what_it_carries_and_only_the_grasp_force_rises_with_the_grasp_force():
    bench, plain = Bench(law__observer__time=0.02), Bench()
    force = plain.step(forces=FORCES).torque
    drive = bench.step(50, forces=FORCES).torque
    assert np.linalg.norm(drive - force) > 0.1  # the observed load
    lost = {"contacts": bench.nowhere, "forces": FORCES}
    np.testing.assert_allclose(bench.step(**lost).torque, drive, atol=1e-9)
    risen = bench.step(grasp_force=15.0, **lost).torque
    np.testing.assert_allclose(risen - drive, 0.5 * force, atol=1e-9)
    bench.step(forces=FORCES)
    held = bench.hold().torque
    np.testing.assert_allclose(held, drive, atol=1e-2 * np.linalg.norm(drive))


def test_gravity_is_carried_in_every_mode():
    bench = Bench(gravity_compensation=True)
    weight = bench.controller.hand.gravity_torque(bench.theta)
    assert np.abs(weight).max() > 0.1
    found = []
    for b in (bench, Bench()):
        torques = [b.step().torque, b.step(contacts=b.nowhere).torque, b.step().torque]
        b.controller.release()
        torques.append(b.step(20).torque)
        b.controller.enabled = False
        found.append([*torques, b.step().torque])
    np.testing.assert_allclose(np.subtract(*found), [weight] * 5, atol=1e-12)


def test_a_finger_that_is_pushed_away_in_a_hold_does_not_take_the_grasp_of_the_others():
    bench = Bench()
    bench.step(5)
    held = bench.step(contacts=bench.nowhere).torque
    away = np.zeros(9)
    away[:3] = -0.1 * np.sign(held[:3])
    pushed = bench.step(contacts=bench.nowhere, theta=bench.theta + away)
    assert pushed.mode is Mode.HOLD and np.abs(held[3:]).max() > 0.1
    assert np.abs(pushed.torque[3:]).max() > 0.8 * np.abs(held[3:]).max()
    limits = bench.controller.hand.effort_limits
    assert (np.abs(pushed.torque) <= limits).all() and (np.abs(pushed.torque) == limits).any()


def test_fingers_that_a_guard_holds_do_not_open_before_they_can():
    bench = Bench()
    bench.step(5)
    bench.controller.release()
    bench.controller.joints_held = True
    bench.step(500)
    np.testing.assert_allclose(bench.step().torque, REST, atol=1e-3)
    bench.controller.joints_held = False
    assert np.abs(bench.step(100).torque).max() > 0.1


def test_contacts_that_a_slow_skin_repeats_move_with_the_fingers():
    """They are where the object, which they carry, has them, up to the second order."""
    slow, fast = Bench(), Bench()
    for bench in (slow, fast):
        bench.step(2)
    for tick in range(1, 4):
        turned = 5e-4 * tick * np.array([1.0, -2.0, 1.5, 0.0, 1.0, -1.0, 2.0, 0.0, -1.5])
        tips = fast.controller.hand.fingertips(fast.theta)
        touch = fast.contacts.positions, fast.contacts.rotations
        there = Contacts(*carried_along(tips, *touch, turned))
        seen = fast.step(theta=fast.theta + turned, contacts=there)
        stale = slow.step(theta=slow.theta + turned)
        np.testing.assert_allclose(stale.torque, seen.torque, atol=1e-4)
    assert np.abs(slow.step().torque - seen.torque).max() > 1e-3


def test_midpoint_hold_extrapolates_by_half_a_tick():
    bench, plain = Bench(midpoint_hold=True), Bench()
    torques = [
        [b.step(grasp_force=force).torque for b in (bench, plain)] for force in (10.0, 11.0, 13.0)
    ]
    np.testing.assert_array_equal(torques[0][0], torques[0][1])
    for (_, before), (ahead, now) in pairwise(torques):
        np.testing.assert_allclose(ahead, now + 0.5 * (now - before), atol=1e-12)


def let_go(bench):
    bench.controller.release()
    bench.step(3)
    assert bench.controller.is_open


def let_go_and_take_again(bench):
    let_go(bench)
    bench.controller.grasp()


def idle(bench):
    bench.controller.enabled = False
    bench.step()
    bench.controller.enabled = True


def miss(bench):
    bench.hold()


@pytest.mark.parametrize("interrupt", [miss, idle, let_go_and_take_again])
def test_midpoint_hold_extrapolates_nothing_over_an_interruption(interrupt):
    bench, plain = Bench(midpoint_hold=True), Bench()
    for b in (bench, plain):
        b.step()
        interrupt(b)
    np.testing.assert_array_equal(*(b.step(grasp_force=14.0).torque for b in (bench, plain)))


@pytest.mark.parametrize("interrupt", [miss, idle])
def test_a_smooth_reference_starts_again_from_where_the_grasp_is(interrupt):
    """An unfinished motion must not pull at the grasp after an interruption."""
    bench = Bench(reference_time=0.05)
    rest = bench.step().torque
    bench.controller.targets.command(bench.target(0.05, 0.02, 0.0, turn=(0.0, 0.0, 0.2)))
    assert np.abs(bench.step(30).torque - rest).max() > 1e-2
    interrupt(bench)
    there = {"contacts": bench.elsewhere(-0.02, 0.01, 0.03, turn=(0.1, -0.1, 0.0))}
    following, start = bench.step(**there).torque, Bench().step(**there).torque
    np.testing.assert_allclose(following, start, atol=1e-12)
    assert np.abs(bench.step(30, **there).torque - start).max() > 1e-2


def integral(*pauses, interrupt=lambda bench: None):
    """Return the integral action after ticks with pauses, s; an event precedes the last."""
    torques = []
    for gain in (1.0, 0.0):
        bench = Bench(law__integral__k_p=gain)
        bench.controller.targets.command(bench.target(0.02, 0.0, 0.0))
        bench.step()
        for i, pause in enumerate(pauses):
            if i == len(pauses) - 1:
                interrupt(bench)
            bench.stamp += round(1e9 * pause) - TICK
            torque = bench.step().torque
        torques.append(torque)
    return np.linalg.norm(torques[0] - torques[1])


def test_a_tick_integrates_at_most_fifty_milliseconds_and_nothing_backwards():
    second = integral(0.01) / 0.01
    assert second > 1e-3
    pauses = (0.002, 0.002), (0.049,), (0.051,), (5.0,), (0.03, -0.01)
    for pause, time in zip(pauses, (0.004, 0.049, 0.05, 0.05, 0.03), strict=True):
        assert integral(*pause) == pytest.approx(time * second, rel=1e-6)


@pytest.mark.parametrize("interrupt", [miss, idle])
def test_nothing_is_integrated_over_an_interruption(interrupt):
    assert integral(0.02, 10.0, interrupt=interrupt) == pytest.approx(integral(0.02), rel=1e-6)


def test_gains_change_while_running(bench):
    bench.controller.targets.command(bench.target(0.05, 0.0, 0.0))
    soft = bench.step().torque
    bench.controller.configure(ControllerConfig().changed({**TABLE_I, "law.k_p": 6.0}))
    stiff = bench.step().torque
    bench.controller.configure(ControllerConfig().changed({**TABLE_I, "law.k_p": 1e-12}))
    none = bench.step().torque
    np.testing.assert_allclose(stiff - none, 2.0 * (soft - none), atol=1e-9)
    assert np.abs(soft - none).max() > 1e-2
    bench.controller.configure(ControllerConfig().changed({**TABLE_I, "law.damping": 0.2}))
    bench.controller.enabled = False
    idling = bench.step(rates=np.ones(9)).torque
    np.testing.assert_allclose(idling, -0.2, atol=1e-15)


def strained(interrupt=lambda bench: None):
    """Return a controller with integral, load, reference and future targets."""
    bench = Bench(**EVERYTHING)
    bench.controller.targets.command(bench.target(0.05, 0.0, 0.0, turn=(0.0, 0.0, 0.3)))
    bench.step(20, forces=FORCES)
    interrupt(bench)
    return bench


def upside_down(bench, *shift):
    """Return contacts elsewhere: a remembered side of the virtual frame would show."""
    return {"contacts": bench.elsewhere(*shift, turn=(3.0, 0.2, 0.1)), "forces": FORCES}


def assert_drives_like(fresh, bench, given, ticks=6):
    """Assert that a controller answers ticks as a new one does."""
    fresh.stamp = bench.stamp
    for _ in range(ticks):
        answer, expected = bench.step(**given), fresh.step(**given)
        assert answer.mode is Mode.DRIVE and answer.reason == ""
        np.testing.assert_array_equal(answer.torque, expected.torque)
        np.testing.assert_array_equal(answer.pose.orientation, expected.pose.orientation)


@pytest.mark.parametrize("interrupt", [lambda bench: None, miss, idle, let_go])
def test_reset_forgets_everything(interrupt):
    bench = strained(interrupt)
    bench.controller.targets.command(bench.target(0.0, 0.05, 0.0), stamp=bench.stamp + 3 * TICK)
    bench.controller.reset()
    assert bench.controller.targets.target is None and not bench.controller.is_open
    with pytest.raises(GraspError, match="no grasp to release; let all fingers touch"):
        bench.controller.release()
    assert_drives_like(Bench(**EVERYTHING), bench, upside_down(bench, 0.0, 0.01, 0.02))


@pytest.mark.parametrize("closing", [False, True])
def test_open_fingers_stay_open_and_closing_ones_go_on_when_the_grasp_is_forgotten(closing):
    """A real hand that forgot this could no longer open or close."""
    bench = strained(let_go)
    if closing:
        bench.controller.grasp()
    bench.controller.forget()
    assert bench.controller.targets.target is None
    assert bench.step(contacts=bench.without_finger(0)).mode is Mode.OPEN
    given = upside_down(bench, 0.0, 0.01, 0.02)
    if not closing:
        assert bench.step(**given).mode is Mode.OPEN
        bench.controller.grasp()
    assert_drives_like(Bench(**EVERYTHING), bench, given)


def test_closing_fingers_open_again_also_when_the_grasp_is_forgotten():
    bench = strained(let_go_and_take_again)
    bench.controller.forget()
    bench.controller.release()
    assert bench.step(5).mode is Mode.OPEN and bench.controller.is_open


def test_after_a_reset_no_hold_goes_on_and_time_may_restart():
    """A future target waits for its tick, even if a later tick came before the reset."""
    bench = strained(miss)
    bench.controller.reset()
    there = bench.theta + np.linspace(-0.2, 0.3, 9)
    held = bench.hold(theta=there, grasp_force=20.0)
    np.testing.assert_array_equal(held.torque, REST)
    bench.stamp = 0
    bench.controller.targets.command(bench.target(0.02, 0.0, 0.0), stamp=4 * TICK)
    for expected in (0.0, 0.0, 0.0, 0.0, 0.02):
        bench.step()
        np.testing.assert_allclose(bench.shift, [expected, 0.0, 0.0], atol=1e-12)


def test_a_new_grasp_keeps_nothing_of_the_old_one():
    """Elsewhere and upside down: from its first tick on, it is treated like a first grasp."""
    bench = strained(let_go_and_take_again)
    assert bench.step(contacts=bench.without_finger(0)).mode is Mode.OPEN
    given = upside_down(bench, 0.01, 0.02, 0.03)
    assert_drives_like(Bench(**EVERYTHING), bench, given)
    assert not bench.controller.is_open
    target = bench.controller.targets.target
    np.testing.assert_allclose(target.position, given["contacts"].centroid, atol=1e-12)


def test_to_close_a_hand_that_is_not_open_changes_nothing(bench):
    drive = bench.step()
    bench.controller.grasp()
    again = bench.step()
    assert again.mode is Mode.DRIVE
    np.testing.assert_array_equal(again.torque, drive.torque)


@pytest.mark.parametrize("before", [lambda bench: None, let_go_and_take_again])
def test_a_release_starts_at_the_posture_of_the_grasp_without_its_grasp_force(before):
    bench = Bench(law__observer__time=0.02)
    bench.step(20, forces=FORCES)
    before(bench)
    bench.step(20, forces=FORCES)
    bench.controller.release()
    first = bench.step()
    assert first.mode is Mode.OPEN
    np.testing.assert_allclose(first.torque, REST, atol=1e-4)
    silent = bench.hold(grasp_force=30.0)
    np.testing.assert_allclose(silent.torque, REST, atol=1e-4)


@pytest.mark.parametrize("opens", [False, True])
def test_fingers_open_from_where_a_user_has_moved_them_while_disabled(bench, opens):
    """They do not spring back, whether they were released before that or are released then."""
    bench.step(20)
    if opens:
        bench.controller.release()
        bench.step(5)
    bench.controller.enabled = False
    there = bench.theta + np.linspace(-0.2, 0.3, 9)
    bench.step(theta=there)
    bench.controller.enabled = True
    if not opens:
        bench.controller.release()
    first = bench.step(theta=there)
    assert first.mode is Mode.OPEN
    np.testing.assert_allclose(first.torque, REST, atol=1e-4)
    assert 0.0 < np.abs(bench.step(10, theta=there).torque).max() < 0.5


def test_fingers_open_at_their_speed_and_make_up_for_no_more_than_50_ms(bench):
    """The held posture, derived from the torques of a spring on a hand that does not move."""
    bench.step()
    bench.controller.release()
    hand, normals = bench.controller.hand, bench.contacts.normals

    def opened():
        turn = np.linalg.solve(bench.stiffness(bench.theta), bench.step().torque)
        posture = bench.theta + turn
        moves = hand.tip_positions(posture) - hand.tip_positions(bench.theta)
        outward = -(moves * normals).sum(axis=1)
        np.testing.assert_allclose(moves, -outward[:, None] * normals, atol=1e-5)
        return outward

    bench.step(50)
    np.testing.assert_allclose(opened(), 0.02 * 0.1, atol=1e-5)
    for pause in (10_000_000_000, -5_000_000_000):
        bench.stamp += pause
        np.testing.assert_allclose(opened(), 0.02 * 0.15, atol=1e-5)


def test_an_interruption_of_the_opening_is_not_made_up_for():
    """Without touch the fingers wait; after a reset they start from their present posture."""
    bench = Bench()
    bench.step()
    bench.controller.release()
    before = bench.step(5).torque
    miss(bench)
    bench.stamp += 10_000_000_000
    np.testing.assert_allclose(bench.step().torque, before, atol=1e-4)
    bench.controller.reset()
    bench.stamp += 10_000_000_000
    bench.step()
    bench.controller.release()
    np.testing.assert_allclose(bench.step().torque, REST, atol=1e-4)


@pytest.mark.parametrize("values", [{"law__integral__k_p": 20.0}, {"reference_time": 0.1}])
def test_after_a_hold_integral_and_reference_go_on_as_if_there_had_been_none(values):
    """Otherwise, many short holds would lose the reference's lead against a load each time."""

    def torques(held_ticks):
        bench = Bench(**values)
        bench.controller.targets.command(bench.target(0.05, -0.02, 0.01))
        before = [bench.step().torque for _ in range(20)]
        bench.controller.joints_held = True
        for _ in range(held_ticks):
            bench.step()
        bench.controller.joints_held = False
        return np.array(before + [bench.step().torque for _ in range(20)])

    np.testing.assert_array_equal(torques(held_ticks=50), torques(held_ticks=0))
    assert np.ptp(torques(0)[20:], axis=0).max() > 1e-3


@pytest.mark.parametrize("guarded", [False, True])
def test_what_a_hold_carries_is_carried_from_the_first_tick_that_acts_again(guarded):
    """A slowly observed load would sag, and make a light hand oscillate at a low rate."""
    light, heavy = np.array([[0.1, 3.0, 0.2]] * 3), np.array([[0.1, 5.0, -1.3]] * 3)
    settled, held = (Bench(law__observer__time=0.05) for _ in range(2))
    settled.step(800, forces=heavy)
    held.step(800, forces=light)
    before = held.step(forces=heavy).torque
    held.controller.joints_held = guarded
    lost = {} if guarded else {"optimal_forces": np.full((3, 3), np.nan)}
    assert held.step(forces=heavy, **lost).mode is (Mode.DRIVE if guarded else Mode.HOLD)
    held.controller.joints_held = False
    after = held.step(forces=heavy).torque
    wanted = settled.step(forces=heavy).torque
    assert np.abs(before - wanted).max() > 0.1
    np.testing.assert_allclose(after, wanted, atol=1e-6)


def test_what_a_hold_has_carried_is_forgotten_while_the_hand_is_disabled():
    light, heavy = np.array([[0.1, 3.0, 0.2]] * 3), np.array([[0.1, 5.0, -1.3]] * 3)

    def torque(**lost):
        bench = Bench(law__observer__time=0.05)
        bench.step(800, forces=light)
        bench.step(forces=light, **lost)
        bench.controller.enabled = False
        bench.step(forces=heavy)
        bench.controller.enabled = True
        return bench.step(forces=heavy).torque

    np.testing.assert_allclose(torque(optimal_forces=np.full((3, 3), np.nan)), torque(), atol=1e-6)


@pytest.mark.parametrize("held", [False, True])
def test_an_answer_without_an_input_is_withheld_where_a_guard_holds(held):
    """A lost contact is no missing input: only the regulator's grasp force may restore it."""
    bench = Bench()
    bench.step()
    bench.controller.joints_held = held
    assert bench.hold().do_not_send == held
    assert not bench.step(contacts=bench.nowhere).do_not_send


def test_touch_is_rejected_while_it_does_not_fit_the_joints(bench):
    wrong = {"contacts": bench.elsewhere(11.0, 0.0, 0.0)}
    for given, rejected in (({}, False), (wrong, True), ({}, False)):
        bench.step(2, **given)
        assert (bench.controller.touch_rejected == rejected).all()
    assert bench.step(optimal_forces=2.0 * bench.optimal).do_not_send
    assert not bench.controller.touch_rejected.any()  # touch may be right all the same


def test_an_input_that_is_implausible_again_is_withheld_for_its_whole_time():
    bench = Bench(input_timeout=0.1)
    wrong = {"optimal_forces": 2.0 * bench.optimal}
    bench.step()
    assert bench.step(50, **wrong).do_not_send and not bench.step(**wrong).do_not_send
    assert not bench.step(optimal_forces=np.full((3, 3), np.nan)).do_not_send
    assert bench.step(50, **wrong).do_not_send and not bench.step(**wrong).do_not_send
    bench.hold()
    assert bench.step(**wrong).do_not_send


def test_a_law_derived_from_14_is_checked_as_that(monkeypatch):
    monkeypatch.setitem(OWN_LAWS, ("mine:Firm", ""), type("Firm", (OptimalLaw,), {}))
    bench = Bench(law__name="mine:Firm")
    assert bench.step().mode is Mode.DRIVE
    command = bench.step(optimal_forces=5.0 * bench.optimal)
    assert command.mode is Mode.HOLD and "f*" in command.reason


def held_torque(*intervals, **values):
    """Return the torque by which a hold opposes a displacement, after ticks, ms apart."""
    bench = Bench(**values)
    for interval in (2.0, *intervals):
        bench.step()
        bench.stamp += round(1e6 * interval) - TICK
    still = bench.hold().torque
    moved = bench.theta + np.linspace(0.0, 0.01, 9)
    return bench.hold(theta=moved).torque - still


def test_the_hold_is_as_stiff_as_the_tick_period_allows_whatever_the_stamps_do():
    exact = held_torque(*[2.0] * 20)
    jitter = 2.0 + 0.15 * np.random.default_rng(3).standard_normal(60)
    away = np.linalg.norm(held_torque(*jitter) - exact)
    np.testing.assert_array_equal(held_torque(*[2.0] * 9, 0.2, 2.0), exact)
    np.testing.assert_array_equal(held_torque(*[2.0, 4.0, 6.0] * 12), exact)  # ticks are skipped
    assert away < 0.25 * np.linalg.norm(exact)
    assert np.linalg.norm(held_torque(*[20.0] * 20)) < 0.1 * np.linalg.norm(exact)


def test_the_present_latency_and_limits_count():
    fitted = {f"law__{name}": 0.0 for name in ("k_p", "k_o", "damping")}
    late, changed = Bench(hold__latency=10, **fitted), Bench(**fitted)
    config = changed.controller.config
    changed.step(5)
    changed.controller.configure(config.changed({"hold.latency": 10}))
    late.step(5)
    moving = {"rates": np.linspace(0.01, 0.05, 9)}
    np.testing.assert_array_equal(changed.step(**moving).torque, late.step(**moving).torque)
    slow = Bench(hold__latency=100)
    slow.step(3)
    assert "would buckle" in slow.controller.warning
    slow.controller.configure(slow.controller.config.changed({"hold.latency": 0}))
    slow.step(grasp_force=0.1)
    assert slow.controller.warning == ""
    slower = Bench(**fitted)
    slower.step(20)
    assert slower.controller.warning == ""
    for _ in range(40):
        slower.stamp += 9 * TICK
        slower.step()
    assert "would buckle: at 50 Hz" in slower.controller.warning


@pytest.mark.parametrize("end", ["open", "disabled"])
def test_a_hand_that_is_open_or_disabled_doubts_nothing(end):
    """Otherwise touch would be rejected forever, because a doubt ends only with a grasp."""
    bench = Bench(input_timeout=0.1)
    bench.step()
    wrong = {"contacts": bench.elsewhere(11.0, 0.0, 0.0)}
    bench.step(100, **wrong)
    assert bench.controller.touch_rejected.all()
    if end == "open":
        bench.controller.release()
    bench.controller.enabled = end == "open"
    assert bench.step(**wrong).mode is Mode(end) and not bench.controller.touch_rejected.any()
    bench.controller.reset()
    bench.controller.enabled = True
    assert bench.step(**wrong).do_not_send  # a new doubt


def test_a_grasp_force_that_rises_while_a_contact_is_lost_is_held_and_never_falls():
    bench = Bench()
    drive = bench.step().torque
    lost = {"contacts": bench.nowhere, "applied": np.full(9, 0.3)}  # which has no effect
    base = bench.step(**lost).torque
    np.testing.assert_allclose(base, drive, atol=1e-12)
    twice = bench.step(grasp_force=20.0, **lost).torque
    np.testing.assert_allclose(twice - base, base, atol=1e-9)  # at rest all of it is grasp force
    for k_f in (10.0, float("nan"), 0.0):
        np.testing.assert_array_equal(bench.step(grasp_force=k_f, **lost).torque, twice)
    silent = bench.hold()
    np.testing.assert_array_equal(silent.torque, twice)
    bench.step()
    np.testing.assert_allclose(bench.step(**lost).torque, base, atol=1e-9)


def test_also_without_a_contact_the_grasp_force_stays_below_its_limit():
    bench = Bench(grasp_force_limit=12.0)
    drive = bench.step().torque
    lost = {"contacts": bench.nowhere}
    for k_f in (math.inf, 40.0, 200.0):
        held = bench.step(grasp_force=k_f, **lost).torque
        np.testing.assert_allclose(held, drive * (1.0 if k_f == math.inf else 1.2), atol=1e-9)


@pytest.mark.parametrize("again", [False, True])
def test_a_new_controller_keeps_the_torque_that_another_has_left(again):
    """After a start or reset during a hold, the object stays held until the inputs arrive."""
    bench, left = Bench(gravity_compensation=True), np.linspace(-0.4, 0.6, 9)
    if again:
        bench.step()
        bench.step(contacts=bench.nowhere, grasp_force=20.0)
        bench.controller.forget()
    # A larger k_f does not raise a torque of unknown k_f.
    held = bench.hold(applied=left, grasp_force=30.0)
    np.testing.assert_allclose(held.torque, left, atol=1e-12)
    without = bench.step(contacts=bench.without_finger(1), applied=0.5 * left)
    np.testing.assert_allclose(without.torque, left, atol=1e-12)


@pytest.mark.parametrize(
    "applied", [None, np.zeros(9), np.full(9, np.nan), np.where(np.arange(9) == 4, np.nan, 0.3)]
)
def test_where_no_torque_is_known_a_new_controller_only_keeps_the_posture(bench, applied):
    held = bench.hold(applied=applied)
    without = bench.step(contacts=bench.without_finger(0), applied=applied)
    assert without.mode is Mode.HOLD and without.pose is None
    np.testing.assert_array_equal([held.torque, without.torque], [REST, REST])


@pytest.mark.parametrize("mode", [Mode.DISABLED, Mode.OPEN])
def test_a_hand_that_was_disabled_or_is_open_takes_no_torque_over(bench, mode):
    bench.step()
    if mode is Mode.OPEN:
        bench.controller.release()
    bench.controller.enabled = mode is Mode.OPEN
    bench.controller.forget()
    assert bench.step().mode is mode
    bench.controller.enabled = True
    held = bench.hold(applied=np.full(9, 0.3))
    np.testing.assert_allclose(held.torque, REST, atol=1e-4)
