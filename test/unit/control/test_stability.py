# SPDX-License-Identifier: Apache-2.0
"""Gains fit a hand: stiff enough for its load, and damped as its delays and encoders allow."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.hands import prism_grasp
from support.plants import pressing, rates_of_twists

from studies.invariance import resized
from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.command_guard import LATE, TOO_FAST
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.stability import buckling_rate, fitted_gains
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant


def buckling(folder, scale, mass, force=18.0):
    """Return the rate at which a grasp of the paper's hand in another size buckles."""
    plant = Plant(resized("gravity", scale, mass, 0.1, folder, {}).plant)
    grasp = plant.hand, plant.state.theta, plant.state.contacts
    return buckling_rate(*grasp, force * pressing(plant))


def test_how_fast_a_grasp_buckles_follows_from_force_lever_and_inertia(tmp_path):
    """p^2 M_h = force x lever, and M_h grows with the square of the size."""
    full = buckling(tmp_path, 1.0, 0.25)
    assert full == pytest.approx(18.49, rel=1e-3)  # in the plant 18.5
    for scale, mass, force in ((0.25, 0.25, 18.0), (1.0, 0.03, 18.0), (0.25, 0.01, 5.0)):
        found = buckling(tmp_path, scale, mass, force)
        expected = full * np.sqrt(0.25 / mass * force / 18.0 / scale)
        assert found == pytest.approx(expected, rel=1e-6)


def test_a_gripper_of_one_joint_does_not_buckle_wherever_its_contacts_are_felt():
    """The object alone turns about their line, with joint rates that are nothing but rounding."""
    plant = Plant(load_scenario("panda").plant)
    contacts, forces = plant.state.contacts, np.outer([1.0, -1.0], [0.01, -5.0, 0.02])
    for noise in 1e-4 * np.random.default_rng(1).standard_normal((20, 2, 3)):
        felt = Contacts(contacts.positions + noise, contacts.rotations)
        assert buckling_rate(plant.hand, plant.state.theta, felt, forces) == 0.0


@pytest.mark.parametrize("tick", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize("name", ["pull", "human_hold"])
def test_gains_that_fit_a_hand_leave_each_motion_its_damping(tick, name):
    plant = Plant(load_scenario(name).plant)
    grasp = plant.hand, plant.state.theta, plant.state.contacts
    damping, stiffness = fitted_gains(*grasp, pressing(plant), tick, 0.01, 0.02).at(3.0, 2.0)
    inertia = plant.hand.dynamics(grasp[1], np.zeros(9)).inertia
    speed = np.linalg.eigvals(np.linalg.solve(inertia, damping))
    assert_allclose(speed, 1.0 / tick)
    # A pose that is late, and an object of 1.5 times a load of 2 N, cost 0.25 rad.
    late = 0.01 + max(0.02, 3.0 * tick)
    rates, arms = rates_of_twists(plant), grasp[2].positions - grasp[2].centroid
    of_motion = np.linalg.inv(rates.T @ damping @ rates)
    body = 1.5 * 2.0 / 9.81 * np.diag(np.repeat([1.0, (arms**2).sum() / 3.0], 3))
    inverse = 4.0 * (late * of_motion + of_motion @ body @ of_motion)
    turns = np.repeat([1.0, 2.0], 3)  # r_d for an angle
    assert_allclose(stiffness * turns @ inverse, np.eye(6), atol=1e-6)


@pytest.mark.parametrize("bits", [14, 16])
def test_an_object_above_its_contacts_does_not_topple(bits):
    """300 g, with the center of mass 20 mm higher, in light fingers."""
    box = {"size": [0.04, 0.04, 0.09], "mass": 0.3, "position": [0.0, 0.0, 0.0819]}
    changes = {f"plant.object.{name}": value for name, value in box.items()}
    changes |= {"plant.encoder.bits": bits, "duration": 2.5}
    record = ClosedLoop(load_scenario("human_hold", changes)).run()
    late = record.object_quaternion[1000:]
    assert np.abs(late @ late[0]).min() > np.cos(0.5 * 0.1)  # half of an angle of 0.1 rad


@pytest.mark.parametrize(
    ("rate", "delay", "allowed", "is_kept"),
    [(1000, 0, 3, True), (1000, 3, 3, True), (500, 2, 3, True), (1000, 3, 0, False)],
)
def test_the_law_allows_for_late_torques(rate, delay, allowed, is_kept):
    """The light fingers of the human hand under a sudden pull, which late torques would lose."""
    pull = {"kind": "ramp", "start": 0.1, "duration": 0.2, "force": [0.0, 0.0, -4.0]}
    changes = {"plant.rate": rate, "plant.disturbances": [pull]}
    changes["manipulation_controller.hold.latency"] = allowed
    watch = Watch(GuardedLoop(load_scenario("human_pull", changes)))
    watch.run(1.0, delay=delay)
    assert not (is_kept and watch.is_lost)
    assert (watch.slid < 1e-3) is is_kept


@pytest.mark.parametrize(("rate", "delay"), [(1000, 2), (500, 1)])
def test_a_heavy_object_and_a_delay_of_two_milliseconds_need_no_more_force(rate, delay):
    """Noise of the skin does not make the fingers swing, which the regulator would answer."""
    skin = {"tactile_sensor.rate": rate, "tactile_sensor.bandwidth": 0.4 * rate}
    loop = GuardedLoop(load_scenario("human_lift", skin | {"plant.rate": rate}))
    Watch(loop).run(3.5, delay=delay)
    assert loop.loop.regulator.grasp_force < 12.0
    assert loop.loop.state.slid.max() < 1e-4


def test_commands_that_become_a_tick_late_at_200_hertz_make_no_light_finger_swing():
    """Rates from angles are late, too; gains that did not allow for it lost the object."""
    skin = {"tactile_sensor.rate": 200.0, "tactile_sensor.bandwidth": 80.0}
    loop = GuardedLoop(load_scenario("human_turn", skin | {"plant.rate": 200.0}))
    loop.run(2.2)
    Watch(loop).run(3.8, delay=1)
    assert not loop.guard.holds[TOO_FAST] + loop.guard.holds[LATE]
    assert loop.loop.state.slid.max() < 1e-4


@pytest.mark.parametrize("joints", [[3, 3, 3], [4, 4, 4, 4], [3, 4, 3, 5, 4]])
def test_with_encoders_only_what_moves_the_object_is_damped_as_k_f_needs_it(tmp_path, joints):
    plant = Plant(load_scenario("gravity", prism_grasp(tmp_path, joints)).plant)
    hand, theta, contacts = plant.hand, plant.state.theta, plant.state.contacts
    how = pressing(plant), 1e-3, 0.01, 0.02, 1e-3
    gains = fitted_gains(hand, theta, contacts, *how)
    inertia = hand.dynamics(theta, np.zeros(hand.joints))[1]
    allowed = 0.03 * hand.finger_weight * hand.spans.max()
    quietest = np.sqrt(allowed / (1e-3 * np.linalg.eigvalsh(inertia)))

    def bandwidths(grasp_force):
        return np.linalg.eigvals(np.linalg.solve(inertia, gains.at(grasp_force, 0.0)[0])).real

    quiet = np.sort(bandwidths(0.0))  # each axis shakes the hand alike: light joints bear more
    assert quiet[0] > 0.999 * quietest.min() and 0.5 < quiet[-1] / quietest.max() < 1.001
    assert np.sort(bandwidths(1e9))[-6:] == pytest.approx(1000.0, rel=1e-6)
    most = 0.5 * (quietest.max() + 1000.0)
    found = np.sort(bandwidths(most / gains.needed))
    assert found[-7] < 1.001 * quietest.max()
    assert_allclose(found[-6:], most, rtol=1e-6)
    # Torques that are two ticks late, and rates that are half a tick late, allow less than half.
    gains = fitted_gains(hand, theta, contacts, *how, 2)
    assert np.sort(bandwidths(1e9))[-6:] == pytest.approx(1250.0 / 3.0, rel=1e-6)
