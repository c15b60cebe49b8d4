# SPDX-License-Identifier: Apache-2.0
"""Who publishes what to whom."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.scenario.scenario import Scenario

_ACTING = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)


@dataclass(frozen=True)
class Link:
    """One topic, who publishes it and who must have subscribed to it.

    Attributes:
        topic: Relative name.
        publisher: A node.
        subscribers: Other nodes.
        each_tick: Whether each tick has a message of it.
    """

    topic: str
    publisher: str
    subscribers: tuple[str, ...] = ()
    each_tick: bool = True


def links(scenario: Scenario) -> list[Link]:
    """Return the topics between the nodes of a scenario.

    Optimizer and controller listen to forces only where they are configured to use them, and the
    sensor to joints only where it reports contacts by a wrong model of the hand.
    """
    fingers = load_hand_config(scenario.hand).finger_names
    observer = scenario.manipulation_controller.law.observer
    shaping = (names.OPTIMIZER,) if scenario.force_optimizer.cones else ()
    feeling = (names.REGULATOR, *shaping, *((names.CONTROLLER,) if observer.time > 0.0 else ()))
    believing = () if scenario.calibration.is_right else (names.SENSOR,)
    per_finger = [
        link
        for finger in fingers
        for link in (
            Link(names.true_wrench(finger), names.PLANT, (names.SENSOR,)),
            Link(names.wrench(finger), names.SENSOR, feeling),
            Link(names.optimal_force(finger), names.OPTIMIZER, (names.CONTROLLER,)),
        )
    ]
    return [
        Link(names.JOINT_STATES, names.PLANT, (names.CONTROLLER, *believing)),
        Link(names.TRUE_CONTACTS, names.PLANT, (names.SENSOR,)),
        Link(names.TRUE_SLIP, names.PLANT, (names.SENSOR,)),
        Link(names.OBJECT_POSE, names.PLANT),
        _event(names.JOINT_HOLD, names.PLANT, (names.CONTROLLER,)),
        _event(names.TOUCH_REJECTED, names.CONTROLLER, (names.REGULATOR, *shaping)),
        _event(names.ROBOT_DESCRIPTION, names.PLANT),
        Link(names.CLOCK, names.PLANT),
        Link(names.CONTACTS, names.SENSOR, _ACTING),
        Link(names.GRASP_FORCE, names.REGULATOR, (names.CONTROLLER,)),
        Link(names.GRIP_STATE, names.REGULATOR, shaping),
        _event(names.HAPTIC_FEEDBACK, names.REGULATOR),
        Link(names.JOINT_COMMAND, names.CONTROLLER, (names.PLANT,)),
        Link(names.AUXILIARY_POSE, names.CONTROLLER),
        _event(names.ACCEPTED_POSE, names.CONTROLLER),
        _event(names.ACCEPTED_FORCE, names.REGULATOR),
        *(_event(names.accepted_parameters(node), node) for node in _ACTING),
        *(
            _event(names.accepted_requests(node), node)
            for node in (names.REGULATOR, *shaping, names.CONTROLLER)
        ),
        _event(names.rejected(names.REGULATOR), names.REGULATOR),
        _event(names.rejected(names.CONTROLLER), names.CONTROLLER),
        _event(names.DESIRED_POSE, names.ORCHESTRATOR, (names.CONTROLLER,)),
        _event(names.USER_GRASP_FORCE, names.ORCHESTRATOR, (names.REGULATOR,)),
        *per_finger,
    ]


def _event(topic: str, publisher: str, subscribers: tuple[str, ...] = ()) -> Link:
    """Return a topic that has messages now and then."""
    return Link(topic, publisher, subscribers, each_tick=False)
