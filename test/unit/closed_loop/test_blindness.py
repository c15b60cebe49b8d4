# SPDX-License-Identifier: Apache-2.0
"""The hand is blind: only joints and touch determine the torque, whatever the object."""

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.loop import Chain, ClosedLoop
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.scenario.scenario import load_scenario

# Properties of the object that touch cannot measure.
HIDDEN = {
    "mass": {"plant.object.mass": 0.4},
    "inertia": {"plant.object.inertia": [0.002, 0.003, 0.004]},
    "friction": {"plant.object.friction": 0.05},
    "weight": {"gravity": [0.0, 0.0, -2.0]},
    "size behind the contacts": {"plant.object.size": [0.2604, 0.2604, 0.5]},
    "push": {"plant.disturbances": [{"force": [0.2, 0.0, 0.0]}]},
}


def replay(scenario, seen):
    """Return the torques of the controller blocks for recorded joints and touch."""
    chain = Chain(
        SlipRegulator(scenario.slip_regulator, 3),
        ForceOptimizer(scenario.force_optimizer, 3),
        Controller(scenario.manipulation_controller),
    )
    for wish in scenario.targets:
        chain.controller.targets.command(wish.target(), wish.stamp)
    contacts = map(Contacts.from_poses, seen.contact_positions, seen.contact_quaternions)
    joints = seen.theta, seen.rates, seen.torque
    ticks = zip(seen.stamps.tolist(), *joints, contacts, seen.forces, strict=True)
    return np.array([chain.answer(*tick).command.torque for tick in ticks])


@pytest.fixture(scope="module")
def plain():
    return ClosedLoop(load_scenario("paper")).run(100)


@pytest.mark.parametrize("changes", HIDDEN.values(), ids=HIDDEN)
def test_the_same_joints_and_touch_give_the_same_torques_whatever_is_held(plain, changes):
    """Joints and touch alone reproduce the run on the changed object, bit for bit.

    The blocks are built from the unchanged scenario. If the closed loop passed them any property of
    the object, they could not reproduce its torques.
    """
    seen = ClosedLoop(load_scenario("paper", changes)).run(100)
    np.testing.assert_array_equal(replay(load_scenario("paper"), seen), seen.command)
    if "plant.object.size" not in changes:
        assert np.abs(plain.command - seen.command).max() > 1e-9  # the object had an effect
