# SPDX-License-Identifier: Apache-2.0
"""Who publishes what to whom."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_hand_ros.closed_loop.scenario import Scenario
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.ros import interfaces as names

PLANT = "plant"
SENSOR = "tactile_sensor"
REGULATOR = "slip_regulator"
OPTIMIZER = "force_optimizer"
CONTROLLER = "manipulation_controller"
RECORDER = "recorder"
COMPOSED = "composed"  # all nodes but the recorder in one process
ORCHESTRATOR = "orchestrator"


@dataclass(frozen=True)
class Link:
    """One topic, who publishes it and who must have subscribed to it."""

    topic: str
    publisher: str
    subscribers: tuple[str, ...] = ()


def links(scenario: Scenario) -> list[Link]:
    """Return the topics between the nodes of a scenario.

    Optimizer and controller listen to forces only where they are told to make use of them.
    """
    fingers = load_hand_config(scenario.hand).finger_names
    observer = scenario.manipulation_controller.law.observer
    shaping = (OPTIMIZER,) if scenario.force_optimizer.cones else ()
    feeling = (REGULATOR, *shaping, *((CONTROLLER,) if observer.time > 0.0 else ()))
    per_finger = [
        link
        for finger in fingers
        for link in (
            Link(names.true_wrench(finger), PLANT, (SENSOR,)),
            Link(names.wrench(finger), SENSOR, feeling),
            Link(names.optimal_force(finger), OPTIMIZER, (CONTROLLER,)),
        )
    ]
    return [
        Link(names.JOINT_STATES, PLANT, (CONTROLLER,)),
        Link(names.TRUE_CONTACTS, PLANT, (SENSOR,)),
        Link(names.TRUE_SLIP, PLANT, (SENSOR,)),
        Link(names.OBJECT_POSE, PLANT),
        Link(names.ROBOT_DESCRIPTION, PLANT),
        Link(names.CLOCK, PLANT),
        Link(names.CONTACTS, SENSOR, (OPTIMIZER, CONTROLLER)),
        Link(names.GRASP_FORCE, REGULATOR, (CONTROLLER,)),
        Link(names.GRIP_STATE, REGULATOR, shaping),
        Link(names.HAPTIC_FEEDBACK, REGULATOR),
        Link(names.JOINT_COMMAND, CONTROLLER, (PLANT,)),
        Link(names.AUXILIARY_POSE, CONTROLLER),
        Link(names.DESIRED_POSE, ORCHESTRATOR, (CONTROLLER,)),
        Link(names.USER_GRASP_FORCE, ORCHESTRATOR, (REGULATOR,)),
        *per_finger,
    ]
