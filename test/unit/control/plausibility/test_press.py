# SPDX-License-Identifier: Apache-2.0
"""Forces that are not those of the motors are found, and blows and slow skins are none."""

import numpy as np
import pytest
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts, in_palm, joint_torques
from tactile_hand_ros.control.plausibility.press import PressWatch

TICK = 2_000_000
PLANT = plant()
STATE = PLANT.state
CONTACTS = Contacts(STATE.contacts.positions, STATE.contacts.rotations)
TERMS = PLANT.hand.dynamics(STATE.theta, np.zeros(9))
FORCES = np.array([[0.3, 4.0, -0.2], [0.1, 2.5, 0.6], [-0.4, 3.0, 0.5]])


def torque(forces):
    """Return the joint torques at rest that press with forces in contact frames."""
    pressing = in_palm(CONTACTS.rotations, forces, 1.0)
    return joint_torques(*TERMS[0], CONTACTS.positions, pressing) + TERMS[2]


def first_doubt(felt, applied, ticks=100):
    """Return the tick at which forces and torques, functions of the tick, are first doubted."""
    watch = PressWatch()
    for tick in range(ticks):
        seen = felt(tick), torque(applied(tick))
        if watch.step(tick * TICK, np.zeros(9), TERMS, CONTACTS, *seen, 0.3):
            return tick
    return None


def noisy(tick):
    return FORCES + 1e-3 * np.sin(tick + np.arange(9.0)).reshape(3, 3)


ONE = np.array([[-3.0, 3.0, -3.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])


@pytest.mark.parametrize("factor", [ONE, np.array([-3.0, 3.0, -3.0]), 0.0])
def test_forces_out_of_proportion_are_doubted_within_two_ticks(factor):
    assert first_doubt(lambda i: noisy(i) * (factor if i >= 50 else 1.0), noisy) in (50, 51, 52)


def test_true_forces_are_believed_also_while_they_grow_and_at_a_blow():
    assert first_doubt(noisy, noisy) is None
    grows = lambda i: noisy(i) * (1.0 + 0.02 * i)  # noqa: E731
    assert first_doubt(grows, grows) is None
    assert first_doubt(noisy, lambda i: noisy(i) * (1.5 if i == 50 else 1.0)) is None


def test_a_force_that_repeats_is_doubted_when_the_torques_change_and_not_at_rest():
    def stuck(tick):
        return np.vstack([FORCES[:1], noisy(tick)[1:]])

    def grows(tick):
        return noisy(tick) * [[1.0 + 0.004 * tick], [1.0], [1.0]]

    assert first_doubt(stuck, noisy) is None
    assert 20 < first_doubt(stuck, grows) < 60


@pytest.mark.parametrize(("step", "found"), [(0.0, True), (0.005, True), (0.1, False)])
def test_a_small_load_is_enough_for_a_skin_that_has_shown_finer_steps(step, found):
    """0.2 N at each finger, which a skin with coarse steps may well not notice."""

    def felt(tick):
        forces = FORCES + 0.02 * np.sin(min(tick, 20) + np.arange(9.0)).reshape(3, 3)
        return np.round(forces / step) * step if step else forces

    def applied(tick):
        return FORCES + np.array([0.0, 0.0, 0.2]) * min(max(tick - 20, 0) / 30.0, 1.0)

    doubted = first_doubt(felt, applied)
    assert (doubted is not None) == found
    assert not found or 40 < doubted < 60


def test_a_new_grasp_starts_without_a_past():
    watch = PressWatch()
    seen = FORCES, torque(0.2 * FORCES)
    assert watch.step(0, np.zeros(9), TERMS, CONTACTS, *seen, 0.3) == ""
    assert watch.step(TICK, np.zeros(9), TERMS, CONTACTS, *seen, 0.3)
    watch.reset()
    assert watch.step(2 * TICK, np.zeros(9), TERMS, CONTACTS, *seen, 0.3) == ""
