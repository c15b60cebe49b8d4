# SPDX-License-Identifier: Apache-2.0
"""Who publishes what to whom follows from the scenario; the recorder takes all but commands."""

from __future__ import annotations

from typing import Any

import pytest

from tactile_hand_ros import names
from tactile_hand_ros.orchestrator.topology import Link, links
from tactile_hand_ros.scenario.scenario import load_scenario

PLANT, SENSOR, REGULATOR = names.PLANT, names.SENSOR, names.REGULATOR
OPTIMIZER, CONTROLLER, USER = names.OPTIMIZER, names.CONTROLLER, names.ORCHESTRATOR
PLAIN = {
    "force_optimizer.cones": False,
    "manipulation_controller.law.observer.time": 0.0,
}


def by_topic(**changes: Any) -> dict[str, Link]:
    scenario = load_scenario("paper", {**PLAIN, **changes})
    found = links(scenario)
    assert len({link.topic for link in found}) == len(found)
    return {link.topic: link for link in found}


def test_the_topics_of_the_paper_and_their_ends() -> None:
    expected: dict[str, tuple[str, ...]] = {
        "joint_states": (PLANT, CONTROLLER),
        "ground_truth/contacts": (PLANT, SENSOR),
        "ground_truth/slip": (PLANT, SENSOR),
        "ground_truth/object_pose": (PLANT,),
        "joint_hold": (PLANT, CONTROLLER),
        "touch_rejected": (CONTROLLER, REGULATOR),
        "robot_description": (PLANT,),
        "clock": (PLANT,),
        "tactile/contacts": (SENSOR, REGULATOR, OPTIMIZER, CONTROLLER),
        "grasp_force": (REGULATOR, CONTROLLER),
        "grip_state": (REGULATOR,),
        "haptic_feedback": (REGULATOR,),
        "joint_command": (CONTROLLER, PLANT),
        "auxiliary_pose": (CONTROLLER,),
        "accepted/desired_pose": (CONTROLLER,),
        "accepted/user_grasp_force": (REGULATOR,),
        "accepted/slip_regulator/parameters": (REGULATOR,),
        "accepted/force_optimizer/parameters": (OPTIMIZER,),
        "accepted/manipulation_controller/parameters": (CONTROLLER,),
        "accepted/slip_regulator/requests": (REGULATOR,),
        "accepted/manipulation_controller/requests": (CONTROLLER,),
        "rejected/slip_regulator": (REGULATOR,),
        "rejected/manipulation_controller": (CONTROLLER,),
        "desired_pose": (USER, CONTROLLER),
        "user_grasp_force": (USER, REGULATOR),
    }
    for finger in ("finger_1", "finger_2", "finger_3"):
        expected[f"ground_truth/{finger}/wrench"] = (PLANT, SENSOR)
        expected[f"tactile/{finger}/wrench"] = (SENSOR, REGULATOR)
        expected[f"optimal_force/{finger}"] = (OPTIMIZER, CONTROLLER)
    found = {topic: (link.publisher, *link.subscribers) for topic, link in by_topic().items()}
    assert found == expected


@pytest.mark.parametrize(
    ("key", "value", "changed"),
    [
        (
            "force_optimizer.cones",
            True,
            {
                "tactile/finger_2/wrench": (REGULATOR, OPTIMIZER),
                "touch_rejected": (REGULATOR, OPTIMIZER),
                "grip_state": (OPTIMIZER,),
            },
        ),
        (
            "manipulation_controller.law.observer.time",
            0.5,
            {"tactile/finger_2/wrench": (REGULATOR, CONTROLLER)},
        ),
        (
            "calibration.link_lengths",
            1.01,
            {"joint_states": (CONTROLLER, SENSOR)},
        ),
    ],
)
def test_a_node_listens_to_what_it_is_configured_to_use(
    key: str, value: Any, changed: dict[str, tuple[str, ...]]
) -> None:
    before, after = by_topic(), by_topic(**{key: value})
    for topic, subscribers in changed.items():
        assert after[topic].subscribers == subscribers != before[topic].subscribers
    others = {topic for topic in after if after[topic] != before.get(topic)} - set(changed)
    assert all("tactile/finger" in topic or "/requests" in topic for topic in others)
