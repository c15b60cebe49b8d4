# SPDX-License-Identifier: Apache-2.0
"""The hand is blind: joints and touch decide the torque, whatever the object is made of."""

import inspect

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.model import leaves
from tactile_hand_ros.control.controller import Controller, ControllerConfig
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.control.slip.regulator import SlipRegulator, SlipRegulatorConfig
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.skin import TactileReading

# What a hand with touch cannot know of the thing that it holds.
HIDDEN = {
    "mass": {"plant.object.mass": 0.4},
    "inertia": {"plant.object.inertia": [0.002, 0.003, 0.004]},
    "friction": {"plant.object.friction": 0.05},
    "weight": {"gravity": [0.0, 0.0, -2.0]},
    "size behind the contacts": {"plant.object.size": [0.2604, 0.2604, 0.5]},
    "push": {"plant.disturbances": [{"force": [0.2, 0.0, 0.0]}]},
}


def replay(scenario, seen):
    """Return the torques with which the blind blocks answer joints and touch that were recorded."""
    regulator = SlipRegulator(scenario.slip_regulator, 3)
    optimizer = ForceOptimizer(scenario.force_optimizer, 3)
    controller = Controller(scenario.manipulation_controller)
    for wish in scenario.targets:
        controller.command(wish.target(), wish.stamp)
    torques = []
    for i, stamp in enumerate(seen.stamps):
        touch = TactileReading(
            seen.contact_positions[i], seen.contact_quaternions[i], seen.forces[i]
        )
        k_f = regulator.step(int(stamp), touch.contacts, touch.forces)
        optimal = optimizer.solve(touch.contacts).forces
        command = controller.step(
            int(stamp), seen.theta[i], seen.rates[i], touch.contacts, optimal, k_f, touch.forces
        )
        torques.append(command.torque)
    return np.array(torques)


@pytest.mark.parametrize("changes", HIDDEN.values(), ids=HIDDEN)
def test_the_same_joints_and_touch_give_the_same_torques_whatever_is_held(changes):
    """The run on the changed object is explained by joints and touch alone, to the bit.

    The blind blocks are built from the plain scenario; were anything of the object handed to them
    in the closed loop, they could not repeat its torques.
    """
    seen = ClosedLoop(load_scenario("paper", changes)).run(100)
    np.testing.assert_array_equal(replay(load_scenario("paper"), seen), seen.command)
    plain = ClosedLoop(load_scenario("paper")).run(100)
    if "plant.object.size" not in changes:
        assert np.abs(plain.command - seen.command).max() > 1e-9  # the object did matter


@pytest.mark.parametrize("config", [ControllerConfig, ForceOptimizerConfig, SlipRegulatorConfig])
def test_no_parameter_of_a_blind_block_speaks_of_the_object(config):
    names = {part for name in leaves(config) for part in name.split(".")}
    assert not names & {"mass", "inertia", "object", "size", "vertices", "plant"}


@pytest.mark.parametrize(
    "method", [Controller.step, ForceOptimizer.solve, SlipRegulator.step, Controller.command]
)
def test_no_input_of_a_blind_block_is_the_truth(method):
    allowed = {
        "self",
        "stamp",
        "theta",
        "rates",
        "contacts",
        "optimal_forces",
        "grasp_force",
        "forces",
        "applied",
        "cones",
        "target",
    }
    assert set(inspect.signature(method).parameters) <= allowed
