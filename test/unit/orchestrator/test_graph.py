# SPDX-License-Identifier: Apache-2.0
"""Who publishes what to whom follows from the scenario; a run waits until all have matched."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Empty

from tactile_hand_ros import names
from tactile_hand_ros.orchestrator.graph import (
    DuplicateNodeError,
    ExpectedTopic,
    GraphReadiness,
    expected_topics,
)
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import load_scenario

PLANT, SENSOR, REGULATOR = names.PLANT, names.SENSOR, names.REGULATOR
OPTIMIZER, CONTROLLER, USER = names.OPTIMIZER, names.CONTROLLER, names.ORCHESTRATOR
PLAIN = {
    "force_optimizer.cones": False,
    "manipulation_controller.law.observer.time": 0.0,
}


def by_topic(**changes: Any) -> dict[str, ExpectedTopic]:
    scenario = load_scenario("paper", {**PLAIN, **changes})
    found = expected_topics(scenario)
    assert len({each.topic for each in found}) == len(found)
    return {each.topic: each for each in found}


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
    found = {topic: (each.publisher, *each.subscribers) for topic, each in by_topic().items()}
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


SCENARIO = load_scenario("paper", PLAIN)
HAND = "/left"


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    made = Node(USER, context=context, namespace=HAND, start_parameter_services=False)
    yield made
    made.destroy_node()


def all_matched(*, composed: bool = False, recorder: bool = False) -> dict[str, dict[str, str]]:
    """Return what nodes report when all publishers and subscribers have matched."""
    facts: dict[str, dict[str, str]] = {}
    for each in expected_topics(SCENARIO):
        topic, own = f"{HAND}/{each.topic}", each.subscribers
        subscribers = () if composed and each.publisher != USER else own
        subscribers += (names.RECORDER,) * (recorder and each.topic not in names.USER_COMMANDS)
        published = facts.setdefault(f"{HAND}/{each.publisher}", {})
        published[f"publications {topic}"] = str(len(subscribers))
        for name in subscribers:
            facts.setdefault(f"{HAND}/{name}", {})[f"subscriptions {topic}"] = "1"
    return facts


def missing(readiness: GraphReadiness, facts: dict[str, dict[str, str]]) -> list[tuple[str, str]]:
    return [(each.node, each.text) for each in readiness.missing(facts)]


@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize("recorder", [False, True])
def test_nothing_is_missing_where_all_have_matched_and_it_is_not_checked_again(
    node: Node, composed: bool, recorder: bool
) -> None:
    readiness = GraphReadiness(node, SCENARIO, composed=composed, recorder=recorder)
    assert missing(readiness, all_matched(composed=composed, recorder=recorder)) == []
    assert missing(readiness, {}) == []
    lacking = GraphReadiness(node, SCENARIO, composed=composed, recorder=True)
    found = missing(lacking, all_matched(composed=composed))
    recorded = [e.topic for e in expected_topics(SCENARIO) if e.topic not in names.USER_COMMANDS]
    assert [text for name, text in found if name == names.RECORDER] == [
        f"recorder does not receive {HAND}/{topic} yet" for topic in recorded
    ]


def test_who_has_not_matched_is_named(node: Node) -> None:
    readiness = GraphReadiness(node, SCENARIO, composed=False, recorder=False)
    facts, topic = all_matched(), f"{HAND}/tactile/contacts"
    facts[f"{HAND}/{SENSOR}"][f"publications {topic}"] = "1"
    facts[f"{HAND}/{OPTIMIZER}"][f"subscriptions {topic}"] = "0"
    assert missing(readiness, facts) == [
        (OPTIMIZER, f"{OPTIMIZER} does not receive {topic} yet"),
        (SENSOR, f"{SENSOR} has matched 1 of 3 subscribers of {topic}"),
    ]
    assert missing(readiness, all_matched()) == []


def test_a_node_that_has_not_reported_is_missing_in_one_process_too(node: Node) -> None:
    readiness = GraphReadiness(node, SCENARIO, composed=True, recorder=False)
    facts = all_matched(composed=True)
    del facts[f"{HAND}/{OPTIMIZER}"]
    assert {name for name, _ in missing(readiness, facts)} == {OPTIMIZER}


def test_a_subscriber_from_outside_must_be_matched_too(node: Node, context: Context) -> None:
    readiness = GraphReadiness(node, SCENARIO, composed=False, recorder=False)
    viewer = Node("viewer", context=context, namespace=HAND)
    viewer.create_subscription(Empty, names.CLOCK, print, 1)
    topic = f"{HAND}/clock"
    wait_until(lambda: node.count_subscribers(topic) == 1)
    assert missing(readiness, all_matched()) == [
        (PLANT, f"plant has matched 0 of 1 subscribers of {topic}")
    ]
    viewer.destroy_node()


def test_a_second_node_of_the_same_name_is_an_error(node: Node, context: Context) -> None:
    twice = [Node(PLANT, context=context, namespace=HAND) for _ in range(2)]
    wait_until(lambda: node.get_node_names().count(PLANT) == 2)
    readiness = GraphReadiness(node, SCENARIO, composed=False, recorder=False)
    with pytest.raises(DuplicateNodeError, match="'/left/plant' runs already"):
        missing(readiness, all_matched())
    for each in twice:
        each.destroy_node()
