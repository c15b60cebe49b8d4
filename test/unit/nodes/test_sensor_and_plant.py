# SPDX-License-Identifier: Apache-2.0
"""The sensor's messages for true contacts, and the plant's reaction to commands."""

from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from support.nodes import tapped

from tactile_hand_ros import names
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.nodes.tactile_sensor import TactileSensorNode
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant

TICK = 2_000_000
PLANT = Plant(load_scenario("paper").plant)
STATE, HAND = PLANT.state, PLANT.hand
TRUE, STILL = STATE.touch, np.zeros(3)


def sense(node: Any, stamp: int) -> Any:
    return node.step(stamp, TRUE, STILL, STATE.theta)


def test_noise_is_live_and_repeats_when_the_ticks_start_over(here):
    node = here.make(TactileSensorNode, force_noise=0.1)
    sent = tapped(node)
    node.on_repeat()
    assert not any(sent.values())
    first = sense(node, 0).forces
    assert not np.array_equal(first, TRUE.forces)
    assert not np.array_equal(sense(node, TICK).forces, first)
    node.on_restart()
    np.testing.assert_array_equal(sense(node, 0).forces, first)
    node.set_parameters([Parameter("force_noise", value=0.0)])
    np.testing.assert_array_equal(sense(node, TICK).forces, TRUE.forces)
    node.on_repeat()
    assert all(messages[-1] == messages[-2] for messages in sent.values()) and len(sent) == 4


def test_the_faults_of_fingers_are_live_if_they_are_as_many(here):
    node = here.make(TactileSensorNode)
    (refused,) = node.set_parameters([Parameter("faults", value=["off"])])
    assert not refused.successful and "each of 3 fingers" in refused.reason
    np.testing.assert_array_equal(sense(node, 0).forces, TRUE.forces)
    (taken,) = node.set_parameters([Parameter("faults", value=["none", "off", "none"])])
    assert taken.successful
    assert np.isnan(sense(node, TICK).positions).any(axis=1).tolist() == [False, True, False]


def test_who_comes_late_still_gets_the_description_of_the_hand(here):
    """It is published once, before any subscriber exists."""
    here.make(PlantNode, composed=False, autostart=False)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    here.receive(String, names.ROBOT_DESCRIPTION, latched)
    (message,) = here.messages(names.ROBOT_DESCRIPTION, 1)
    assert message.data == HAND.description
