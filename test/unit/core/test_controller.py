# SPDX-License-Identifier: Apache-2.0
"""The controller: driving, holding, disabled, targets now and later, and what it refuses."""

import numpy as np
import pytest
from support.grasps import moved
from support.plants import plant

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.core.controller import Controller, ControllerConfig, Mode
from tactile_hand_ros.core.errors import PoseError
from tactile_hand_ros.core.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.core.manipulation import Target
from tactile_hand_ros.core.rotations import rotation_from_vector

TICK = 2_000_000
REST = np.zeros(9)


class Bench:
    """A controller that sees the paper's grasp at rest."""

    def __init__(self, **values):
        state = plant().state
        changes = {name.replace("__", "."): value for name, value in values.items()}
        self.controller = Controller(ControllerConfig().changed(changes))
        self.theta, self.contacts, self.rates = state.theta, state.contacts, REST
        self.optimal = ForceOptimizer(ForceOptimizerConfig(), 3).solve(self.contacts).forces
        self.grasp_force, self.stamp = 10.0, 0

    def step(self, ticks=1, **given):
        """Answer the next ticks; return the last command."""
        for _ in range(ticks):
            seen = {
                "theta": self.theta,
                "rates": self.rates,
                "contacts": self.contacts,
                "optimal_forces": self.optimal,
                "grasp_force": self.grasp_force,
                **given,
            }
            command = self.controller.step(self.stamp, **seen)
            self.stamp += TICK
        return command

    def without_finger(self, finger):
        positions = self.contacts.positions.copy()
        rotations = self.contacts.rotations.copy()
        positions[finger] = rotations[finger] = np.nan
        return Contacts(positions, rotations)

    @property
    def centroid(self):
        return self.contacts.centroid

    def target(self, *shift, turn=(0.0, 0.0, 0.0)):
        return Target(self.centroid + np.array(shift), rotation_from_vector(turn))


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
    np.testing.assert_allclose(bench.controller.target.position, bench.centroid)


def test_a_target_takes_effect_at_the_next_tick(bench):
    rest = bench.step().torque
    bench.controller.command(bench.target(0.05, 0.0, 0.0))
    command = bench.step()
    assert np.abs(command.torque - rest).max() > 1e-2
    np.testing.assert_allclose(bench.controller.target.position[0], bench.centroid[0] + 0.05)


def test_a_target_may_come_before_the_first_tick(bench):
    bench.controller.command(bench.target(0.05, 0.0, 0.0))
    bench.step()
    np.testing.assert_allclose(bench.controller.target.position[0], bench.centroid[0] + 0.05)


def test_a_future_target_waits_for_its_tick(bench):
    rest = bench.step().torque
    bench.controller.command(bench.target(0.05, 0.0, 0.0), stamp=4 * TICK)
    np.testing.assert_array_equal(bench.step(3).torque, rest)
    assert bench.stamp == 4 * TICK
    assert np.abs(bench.step().torque - rest).max() > 1e-2


def test_of_several_targets_the_latest_due_one_counts(bench):
    bench.step(5)
    bench.controller.command(bench.target(0.03, 0.0, 0.0), stamp=7 * TICK)
    bench.controller.command(bench.target(0.01, 0.0, 0.0), stamp=1 * TICK)
    bench.controller.command(bench.target(0.02, 0.0, 0.0), stamp=0)
    wanted = []
    for _ in range(4):
        bench.step()
        wanted.append(bench.controller.target.position[0] - bench.centroid[0])
    np.testing.assert_allclose(wanted, [0.02, 0.02, 0.03, 0.03], atol=1e-12)


def test_a_target_out_of_reach_is_refused_at_once_and_the_last_stays(bench):
    bench.controller.command(bench.target(0.05, 0.0, 0.0))
    bench.step()
    with pytest.raises(PoseError, match=r"out of reach: finger_\d would stay \d+ mm short"):
        bench.controller.command(bench.target(0.0, 0.0, 2.0))
    assert bench.step().reason == ""
    np.testing.assert_allclose(bench.controller.target.position[0], bench.centroid[0] + 0.05)


def test_a_target_that_is_out_of_reach_when_due_is_refused_with_its_reason(bench):
    """Before the first tick nothing is known of the grasp: it is checked when it is due."""
    bench.controller.command(bench.target(0.0, 0.0, 2.0))
    command = bench.step()
    assert command.mode is Mode.DRIVE and "out of reach" in command.reason
    np.testing.assert_allclose(bench.controller.target.position, bench.centroid)
    assert bench.step().reason == ""


def test_nan_is_out_of_reach(bench):
    bench.step()
    with pytest.raises(PoseError):
        bench.controller.command(Target(np.array([np.nan, 0.0, 0.4]), np.eye(3)))


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (lambda b: {"contacts": b.without_finger(1)}, "no contact at finger_2"),
        (lambda b: {"optimal_forces": np.full((3, 3), np.nan)}, "no optimal force"),
        (lambda b: {"grasp_force": float("nan")}, "k_f = nan"),
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
    # At rest and at the target the drive is the squeeze alone, and holding keeps exactly that.
    np.testing.assert_allclose(held.torque, drive.torque, atol=1e-9)
    away = bench.theta + 0.01
    pushed = bench.step(theta=away, **given(bench)).torque
    np.testing.assert_allclose(pushed - held.torque, -10.0 * 0.01, atol=1e-9)
    rubbed = bench.step(rates=np.ones(9), **given(bench)).torque
    np.testing.assert_allclose(rubbed - held.torque, -0.5, atol=1e-9)
    again = bench.step()
    assert again.mode is Mode.DRIVE
    np.testing.assert_allclose(again.torque, drive.torque, atol=1e-9)


def test_law_10_needs_no_optimal_force():
    bench = Bench(law__name="contact")
    assert bench.step(optimal_forces=np.full((3, 3), np.nan)).mode is Mode.DRIVE


def test_a_hold_from_the_first_tick_has_no_squeeze_to_keep(bench):
    command = bench.step(contacts=bench.without_finger(0))
    assert command.mode is Mode.HOLD and command.pose is None
    np.testing.assert_array_equal(command.torque, REST)


def test_a_second_hold_starts_from_its_own_posture(bench):
    bench.step()
    bench.controller.hold(bench.theta, REST, "silence")
    bench.step()
    there = bench.theta + 0.05
    drive = bench.step(theta=there)
    held = bench.controller.hold(there, REST, "silence")
    assert held.reason == "silence" and held.mode is Mode.HOLD
    assert np.abs(held.torque - drive.torque).max() < 0.2  # no spring back to the first posture


def test_disabled_means_damping_only_and_enabled_drives_again(bench):
    drive = bench.step()
    bench.controller.enabled = False
    rates = np.linspace(-1.0, 1.0, 9)
    for command in (bench.step(rates=rates), bench.controller.hold(bench.theta, rates, "silence")):
        assert command.mode is Mode.DISABLED
        np.testing.assert_allclose(command.torque, -0.07 * rates, atol=1e-15)
    bench.controller.enabled = True
    np.testing.assert_allclose(bench.step().torque, drive.torque, atol=1e-9)


def test_after_disabling_a_hold_keeps_no_old_squeeze(bench):
    bench.step()
    bench.controller.enabled = False
    bench.step()
    bench.controller.enabled = True
    held = bench.controller.hold(bench.theta, REST, "silence")
    np.testing.assert_array_equal(held.torque, REST)


def test_gravity_is_carried_in_every_mode():
    bench = Bench(gravity_compensation=True)
    weight = bench.controller.hand.gravity_torque(bench.theta)
    assert np.abs(weight).max() > 0.1
    plain = Bench()
    np.testing.assert_allclose(bench.step().torque - plain.step().torque, weight, atol=1e-12)
    for b in (bench, plain):
        b.held = b.step(contacts=b.without_finger(0)).torque
        b.controller.enabled = False
        b.idle = b.step().torque
    np.testing.assert_allclose(bench.held - plain.held, weight, atol=1e-12)
    np.testing.assert_allclose(bench.idle - plain.idle, weight, atol=1e-12)


def test_midpoint_hold_extrapolates_by_half_a_tick():
    bench, plain = Bench(midpoint_hold=True), Bench()
    torques = []
    for force in (10.0, 11.0, 13.0):
        bench.grasp_force = plain.grasp_force = force
        torques.append((bench.step().torque, plain.step().torque))
    np.testing.assert_array_equal(torques[0][0], torques[0][1])
    for (_, before), (ahead, now) in zip(torques, torques[1:]):
        np.testing.assert_allclose(ahead, now + 0.5 * (now - before), atol=1e-12)
    bench.controller.hold(bench.theta, REST, "silence")
    plain.controller.hold(plain.theta, REST, "silence")
    np.testing.assert_array_equal(bench.step().torque, plain.step().torque)


def integral_torque(interrupt):
    """Return the size of the integral action after 22 ticks with something in the middle."""
    torques = []
    for gains in ({"law__integral__k_p": 1.0}, {}):
        bench = Bench(**gains)
        bench.controller.command(bench.target(0.02, 0.0, 0.0))
        bench.step(11)
        interrupt(bench)
        torques.append(bench.step(11).torque)
    return np.linalg.norm(torques[0] - torques[1])


def silence(bench):
    bench.controller.hold(bench.theta, REST, "silence")
    bench.stamp += 10_000_000_000


def restart(bench):
    bench.stamp = 0


@pytest.mark.parametrize("interrupt", [silence, restart])
def test_nothing_is_integrated_over_an_interruption(interrupt):
    """Ten silent seconds must not become ten seconds of integral action, nor a restart undo it."""
    without = integral_torque(lambda bench: None)
    assert without > 1e-4
    assert integral_torque(interrupt) == pytest.approx(20 / 21 * without)


def test_gains_change_while_running(bench):
    bench.controller.command(bench.target(0.05, 0.0, 0.0))
    soft = bench.step().torque
    bench.controller.configure(ControllerConfig().changed({"law.k_p": 6.0}))
    stiff = bench.step().torque
    bench.controller.configure(ControllerConfig().changed({"law.k_p": 0.0}))
    none = bench.step().torque
    np.testing.assert_allclose(stiff - none, 2.0 * (soft - none), atol=1e-9)


def test_reset_forgets_grasp_target_and_integral():
    bench = Bench(law__integral__k_p=1.0, midpoint_hold=True)
    fresh = bench.step().torque
    bench.controller.command(bench.target(0.05, 0.0, 0.0))
    bench.controller.command(bench.target(0.0, 0.05, 0.0), stamp=10**12)
    bench.step(5)
    bench.controller.reset()
    assert bench.controller.target is None
    bench.stamp = 0
    np.testing.assert_allclose(bench.step().torque, fresh, atol=1e-12)


def test_a_squeeze_that_rises_while_a_contact_is_lost_is_held_and_never_falls():
    bench = Bench()
    bench.step()
    lost = {"contacts": bench.without_finger(2)}
    base = bench.step(**lost).torque
    twice = bench.step(grasp_force=20.0, **lost).torque
    np.testing.assert_allclose(twice - base, base, atol=1e-9)  # at rest all of it is squeeze
    for k_f in (10.0, float("nan"), 0.0):
        np.testing.assert_array_equal(bench.step(grasp_force=k_f, **lost).torque, twice)
    silent = bench.controller.hold(bench.theta, REST, "touch is late")
    np.testing.assert_array_equal(silent.torque, twice)
    bench.step()
    np.testing.assert_allclose(bench.step(**lost).torque, base, atol=1e-9)
