# SPDX-License-Identifier: Apache-2.0
"""The laws (8), (10), (14) against their formulas, and what the joints can bear of them."""

from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.equations import grasp_map, hand_jacobian, rotation_error
from support.grasps import FORCES, balance_in_frames, contacts_at

from tactile_hand_ros.control.laws import (
    LAWS,
    FittedGains,
    KawamuraLaw,
    LawConfig,
    LawInput,
    ManipulationLaw,
    NormalForceControl,
    Target,
    bearable_fraction,
)
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_vector

RADII = np.array([0.06, 0.05, 0.04])
K_F, DT = 7.0, 0.002
GAINS = {"k_p": 3.0, "k_o": 0.5, "damping": 0.07, "k_st": 0.3, "r_ref": (0.1, -0.2, 0.3)}


class Grip:
    """The paper's hand in an asymmetric posture, with asymmetric contact normals."""

    def __init__(self, seed=3):
        random = np.random.default_rng(seed)
        hand = Hand.load("paper")
        self.theta = np.tile([1.047, 0.0, 1.571], 3) + random.uniform(-0.2, 0.2, 9)
        self.rates = random.uniform(-1.0, 1.0, 9)
        self.tips = hand.fingertips(self.theta)
        inward = np.array([[-1.0, 0, 0], [1.0, 0, 0], [0, -1.0, 0]])
        normals = inward + random.uniform(-0.3, 0.3, (3, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        self.contacts = contacts_at(self.tips.positions + RADII[:, None] * normals, normals)
        self.optimal = ForceOptimizer(ForceOptimizerConfig(), 3).solve(self.contacts).forces
        self.jacobian = hand_jacobian(*self.tips, self.contacts.positions)
        turn = rotation_from_vector(random.uniform(-0.5, 0.5, 3))
        self.target = Target(self.contacts.centroid + random.uniform(-0.1, 0.1, 3), turn)

    def torque(self, name, target=None, law=None, forces=None):
        law = law or ManipulationLaw(LawConfig(name=name, **GAINS), RADII)
        pose = law.auxiliary_pose(self.tips, self.contacts)
        seen = LawInput(self.tips, self.contacts, self.optimal, K_F)
        return law.step(seen, self.rates, target or self.target, pose, DT, forces)

    def net(self, forces):
        """Return the wrench of forces in contact frames about the centroid, shape (6,)."""
        return balance_in_frames(self.contacts) @ forces.ravel()

    def carrying(self, wrench):
        """Return the torques of (14) for a wrench, J_h^T G~^+ wrench, shape (9,)."""
        about_centroid = grasp_map(self.contacts.positions, self.contacts.centroid)
        return self.jacobian.T @ np.linalg.pinv(about_centroid) @ wrench


@pytest.fixture
def grip():
    return Grip()


def test_equations_14_and_10_to_the_letter(grip):
    """Both drive by the pose error and damp; they press by f*, or towards the centroid."""
    points = grip.contacts.positions
    shift = grip.target.position - points.mean(axis=0)
    turn = rotation_error(points, grip.target.orientation)
    driven = grip.carrying(np.concatenate([3.0 * shift, 0.5 * turn])) - 0.07 * grip.rates
    optimal = [r @ f for r, f in zip(grip.contacts.rotations, grip.optimal, strict=True)]
    for name, pressing in (("optimal", optimal), ("contact", points.mean(axis=0) - points)):
        expected = driven + K_F * grip.jacobian.T @ np.ravel(pressing)
        np.testing.assert_allclose(grip.torque(name).total, expected, atol=1e-11)


def test_equation_8_to_the_letter(grip):
    """Law (8) uses fingertips only: its centroid and frame are those of their centers."""
    tips = grip.tips.positions
    turn = rotation_error(tips, grip.target.orientation)
    expected = -0.07 * grip.rates
    for i in range(3):
        linear, angular = grip.tips.linear[i].T, grip.tips.angular[i].T
        expected = expected + K_F / RADII.sum() * linear @ (tips.mean(axis=0) - tips[i])
        expected = expected + 0.3 * angular @ np.array([0.1, -0.2, 0.3])
        expected = expected + 3.0 * linear @ (grip.target.position - tips.mean(axis=0))
        expected = expected + 0.5 * angular @ turn
    np.testing.assert_allclose(grip.torque("kawamura").total, expected, atol=1e-11)


def test_a_law_is_built_for_a_configuration_and_not_for_a_tick(grip, monkeypatch):
    counted = Mock(wraps=KawamuraLaw)
    monkeypatch.setitem(LAWS, "kawamura", counted)
    law = ManipulationLaw(LawConfig(name="kawamura", k_st=0.1), RADII)
    for _ in range(3):
        grip.torque("kawamura", law=law)
    law.configure(LawConfig(name="kawamura", **GAINS))
    found = grip.torque("kawamura", law=law).internal
    assert [call.args[0].k_st for call in counted.call_args_list] == [0.1, 0.3]
    np.testing.assert_array_equal(found, grip.torque("kawamura").internal)


def integral_law(**integral):
    return ManipulationLaw(LawConfig(k_p=0.0, k_o=0.0, integral=integral), RADII)


def offset(law, grip, shift, turn=(0.0, 0.0, 0.0)):
    pose = law.auxiliary_pose(grip.tips, grip.contacts)
    return Target(pose.position + np.array(shift), rotation_from_vector(turn) @ pose.orientation)


def test_integral_action_is_the_gain_times_the_integral_of_the_error(grip):
    law = integral_law(k_p=2.0, k_o=0.4)
    target = offset(law, grip, (0.01, 0.0, -0.02), (0.0, 0.1, 0.0))
    for _ in range(100):
        parts = grip.torque("optimal", target, law)
    expected = [2.0 * 0.2 * 0.01, 0.0, -2.0 * 0.2 * 0.02, 0.0, 0.4 * 0.2 * 2 * np.sin(0.1), 0.0]
    np.testing.assert_allclose(law.integral, expected, atol=1e-12)
    np.testing.assert_allclose(parts.load_compensation, grip.carrying(expected), atol=1e-10)


def test_integral_action_stops_at_its_limits_and_comes_back_at_once(grip):
    """Anti-windup: however long the error lasted, one step of the opposite error unloads it."""
    law = integral_law(k_p=100.0, k_o=100.0, force_limit=2.0, torque_limit=0.3)
    there = offset(law, grip, (0.3, 0.0, 0.4), (0.0, 0.0, 0.5))
    for _ in range(500):
        grip.torque("optimal", there, law)
    np.testing.assert_allclose(law.integral, [1.2, 0, 1.6, 0, 0, 0.3], atol=1e-9)
    grip.torque("optimal", offset(law, grip, (-0.3, 0.0, -0.4)), law)
    assert np.linalg.norm(law.integral[:3]) == pytest.approx(2.0 - 100.0 * DT * 0.5)


def test_an_integral_time_adds_as_much_as_the_fitted_gains_in_that_time(grip):
    law, stiffness = integral_law(time=0.5), np.diag([30.0, 40.0, 50.0, 0.2, 0.3, 0.4])
    moves = np.zeros((9, 9)), np.zeros((9, 6)), np.eye(6), stiffness.diagonal()
    law.fit(FittedGains(*moves, 0.0, np.inf, 1.0, np.zeros(6), 0.0))
    target = offset(law, grip, (0.01, 0.02, -0.02), (0.0, 0.1, 0.0))
    for _ in range(100):
        grip.torque("optimal", target, law)
    error = np.array([0.01, 0.02, -0.02, 0.0, np.sin(0.1), 0.0])
    np.testing.assert_allclose(law.integral, 0.2 / 0.5 * stiffness @ error, atol=1e-9)
    law.configure(LawConfig(k_p=0.0, k_o=0.0))
    assert not law.integral.any()


@pytest.mark.parametrize("left", [{"k_p": 3.0}, {"k_o": 0.5}, {}])
def test_an_integral_gain_that_is_switched_off_clears_its_part_and_leaves_the_other(grip, left):
    law = integral_law(k_p=2.0, k_o=0.4)
    target = offset(law, grip, (0.01, 0.03, -0.02), (0.2, 0.1, -0.1))
    grip.torque("optimal", target, law)
    assert np.abs(law.integral).min() > 0.0
    added = np.repeat([left.get("k_p", 0.0) / 2.0, left.get("k_o", 0.0) / 0.4], 3)
    expected = np.where(added > 0.0, 1.0 + added, 0.0) * law.integral
    law.configure(LawConfig(k_p=0.0, k_o=0.0, integral=left))
    carried = grip.torque("optimal", target, law).load_compensation
    np.testing.assert_allclose(law.integral, expected, rtol=1e-12)
    np.testing.assert_allclose(carried, grip.carrying(expected), atol=1e-12)


@pytest.mark.parametrize("gain", [0.0, 2.0])
def test_integral_and_observed_load_are_carried_together(grip, gain):
    """Each is as if alone: the integral of the error, and 1 - exp(-t / T) of the forces."""
    law = ManipulationLaw(LawConfig(integral={"k_p": gain}, observer={"time": 0.02}), RADII)
    target = offset(law, grip, (0.01, 0.0, -0.02))
    for _ in range(10):
        parts = grip.torque("optimal", target, law, forces=FORCES)
    integral = gain * 10 * DT * np.array([0.01, 0.0, -0.02, 0.0, 0.0, 0.0])
    load = (1.0 - np.exp(-10 * DT / 0.02)) * grip.net(FORCES)
    carried = grip.carrying(integral + load)
    np.testing.assert_allclose(parts.load_compensation, carried, atol=1e-11)
    off = grip.torque("optimal", target, ManipulationLaw(LawConfig(), RADII), forces=FORCES)
    np.testing.assert_array_equal(off.load_compensation, 0.0)
    np.testing.assert_allclose(parts.total, off.total + carried, atol=1e-11)
    blind = grip.torque("optimal", target, law).load_compensation
    np.testing.assert_allclose(blind, grip.carrying(1.1 * integral), atol=1e-11)


def test_coarse_encoders_lengthen_the_time_of_the_load_observer(grip):
    """As long as the fitted gains say, if the user's time is not longer."""
    forces, none = np.tile([0.1, 1.0, -0.2], (3, 1)), np.zeros((9, 9))
    for time, lasts in ((0.02, 0.1), (0.3, 0.3)):
        law = ManipulationLaw(LawConfig(observer={"time": time}), RADII)
        moves = none, none[:, :6], np.eye(6), np.ones(6)
        law.fit(FittedGains(*moves, 0.0, np.inf, 1.0, np.zeros(6), 0.1))
        carried = grip.torque("optimal", grip.target, law, forces).load_compensation
        expected = (1.0 - np.exp(-DT / lasts)) * grip.carrying(grip.net(forces))
        np.testing.assert_allclose(carried, expected, atol=1e-9)


def test_a_load_observer_that_is_switched_off_forgets(grip):
    on = LawConfig(observer={"time": 0.02})
    law, fresh = ManipulationLaw(on, RADII), ManipulationLaw(on, RADII)
    for _ in range(20):
        grip.torque("optimal", law=law, forces=FORCES)
    law.configure(LawConfig())
    law.configure(on)
    again = grip.torque("optimal", law=law, forces=FORCES).load_compensation
    expected = grip.torque("optimal", law=fresh, forces=FORCES).load_compensation
    np.testing.assert_array_equal(again, expected)


SHARES = np.array([0.5, 0.2, 0.3])


def gripped(load, fraction, late, ends=(-20.0, 20.0), age=0.016):
    """Return normal forces, 2 s, of weak drives whose contacts receive a fraction of c, late."""
    control, seen, changes = NormalForceControl(), [], [0.0] * late
    for i in range(2000):
        seen.append((8.0 + fraction * changes[i]) * SHARES + load)
        changes.append(control.step(10.0, SHARES, seen[-1], *ends, 0.001, age) - 10.0)
    return np.array(seen)


@pytest.mark.parametrize("fraction", [0.3, 1.0, 1.5])
def test_a_grip_presses_each_finger_with_its_part_and_the_loaded_ones_with_more(fraction):
    load = np.array([-1.0, 0.6, 1.2])  # N, of the object
    seen = gripped(load, fraction, late=16)
    np.testing.assert_allclose(seen[-1], 12.0 * SHARES + load, atol=1e-3)  # 5 N of the first
    least = (seen / (10.0 * SHARES)).min(axis=1)
    assert least[0] == pytest.approx(0.6) and least.max() < 1.03  # hardly an overshoot


def test_the_gain_of_a_grip_is_a_sixth_of_that_at_which_it_oscillates():
    calm, wild = (gripped(0.0, 1.0, late, (-1e9, 1e9))[:, 0] for late in (60, 110))
    assert np.ptp(calm[-200:]) < 0.01 and np.ptp(wild[-500:]) > np.ptp(wild[:500])


def test_a_dead_skin_and_a_crush_limit_bound_the_correction_of_a_grip():
    assert NormalForceControl().step(10.0, SHARES, np.zeros(3), -3.0, 2.0, 1e3, 0.01) == 12.0
    assert NormalForceControl().step(10.0, SHARES, np.full(3, 99.0), -3.0, 2.0, 1e3, 0.01) == 7.0
    unknown = np.array([1.0, np.nan, 1.0])
    assert NormalForceControl().step(10.0, SHARES, unknown, -3.0, 2.0, 1e3, 0.01) == 10.0


def test_a_finger_that_hardly_presses_does_not_raise_the_grip():
    """Where f*_n of a finger is zero up to rounding, its noise shows no missing force."""
    shares, seen = np.array([0.5, 0.5, 1e-17]), np.array([5.0, 5.0, -0.01])
    assert NormalForceControl().step(10.0, shares, seen, -5.0, 5.0, 0.001, 0.02) == 10.0


TORQUES = st.lists(st.floats(-60.0, 60.0), min_size=9, max_size=9).map(np.array)


@given(TORQUES, TORQUES)
def test_the_bearable_fraction_is_the_largest_within_the_limits_where_the_rest_is(force, rest):
    limits = np.full(9, 20.0)
    rest = np.clip(rest, -19.0, 19.0)
    share = bearable_fraction(force, rest, limits)
    assert (np.abs(share * force + rest) <= limits * (1.0 + 1e-12)).all()
    if share < 1.0:
        assert (np.abs((share + 1e-6) * force + rest) > limits).any()


@pytest.mark.parametrize(
    ("force", "rest", "share"),
    [
        (10.0, 10.0, 1.0),  # just at the limit
        (5.0, 30.0, 0.0),  # already beyond it
        (-5.0, 30.0, 1.0),  # a grasp force that relieves the joint
        (0.0, 30.0, 1.0),
    ],
)
def test_a_joint_gives_what_its_limit_leaves(force, rest, share):
    others = np.array([1.0, force, -1.0]), np.array([0.0, rest, 0.0])
    assert bearable_fraction(*others, np.array([5.0, 20.0, 5.0])) == pytest.approx(share)
