# SPDX-License-Identifier: Apache-2.0
"""What is missing for a run to begin: ends that are not there, and ends that have not met."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from tactile_hand_ros import names
from tactile_hand_ros.orchestrator.topology import links
from tactile_hand_ros.orchestrator.wiring import DuplicateNodeError, Wiring, services
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

PLAIN = {"force_optimizer.cones": False, "manipulation_controller.law.observer.time": 0.0}
SCENARIO = load_scenario("paper", PLAIN)
HAND = "/left"
NODES = (
    *(names.ORCHESTRATOR, names.PLANT, names.SENSOR),
    *(names.REGULATOR, names.OPTIMIZER, names.CONTROLLER),
)


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture(scope="module")
def hand(context: Context) -> Iterator[dict[str, Node]]:
    """Nodes with all the ends that the plain scenario needs, none of them recorded."""
    made = {name: new(name, context) for name in NODES}
    for link in links(SCENARIO):
        made[link.publisher].create_publisher(Empty, link.topic, 1)
        for name in link.subscribers:
            made[name].create_subscription(Empty, link.topic, print, 1)
    for name, service in services():
        made[name].create_service(Trigger, service, print)
    yield made
    for node in made.values():
        node.destroy_node()


def new(name: str, context: Context, namespace: str = HAND) -> Node:
    return Node(name, context=context, namespace=namespace, start_parameter_services=False)


def met(scenario: Scenario = SCENARIO) -> dict[str, dict[str, str]]:
    """Return what nodes say of which all ends have met."""
    facts: dict[str, dict[str, str]] = {f"{HAND}/{name}": {} for name in NODES}
    for link in links(scenario):
        topic = f"{HAND}/{link.topic}"
        facts[f"{HAND}/{link.publisher}"][f"publications {topic}"] = str(len(link.subscribers))
        for name in link.subscribers:
            facts[f"{HAND}/{name}"][f"subscriptions {topic}"] = "1"
    return facts


def gaps(wiring: Wiring, facts: dict[str, dict[str, str]] | None = None) -> list[tuple[str, str]]:
    said = met() if facts is None else facts
    return [(gap.node, gap.text) for gap in wiring.missing(said)]


def test_nothing_is_missing_where_all_ends_have_met_and_it_is_not_asked_again(
    hand: dict[str, Node],
) -> None:
    wiring = Wiring(hand[names.ORCHESTRATOR], SCENARIO, recorded=False)
    wait_until(lambda: gaps(wiring) == [])
    assert gaps(wiring, {}) == []


def test_ends_that_have_not_met_are_named(hand: dict[str, Node]) -> None:
    wiring = Wiring(hand[names.ORCHESTRATOR], SCENARIO, recorded=False)
    facts, topic = met(), f"{HAND}/tactile/contacts"
    facts[f"{HAND}/{names.SENSOR}"][f"publications {topic}"] = "1"
    facts[f"{HAND}/{names.OPTIMIZER}"][f"subscriptions {topic}"] = "0"
    wait_until(lambda: len(gaps(wiring, facts)) == 2)
    assert gaps(wiring, facts) == [
        (names.OPTIMIZER, f"{names.OPTIMIZER} has not met the publisher of {topic}"),
        (names.SENSOR, f"{names.SENSOR} has met 1 of 3 subscribers of {topic}"),
    ]
    assert gaps(wiring) == []


def test_a_subscriber_that_is_not_there_is_missing(hand: dict[str, Node]) -> None:
    """That of the cones listens to forces; what is recorded, the recorder."""
    shaped = load_scenario("paper", {**PLAIN, "force_optimizer.cones": True})
    found = Wiring(hand[names.ORCHESTRATOR], shaped, recorded=False)
    wrenches = [f"tactile/finger_{number}/wrench" for number in (1, 2, 3)]
    lacking = [
        (names.OPTIMIZER, f"{names.OPTIMIZER} does not subscribe to {HAND}/{topic}")
        for topic in ("touch_rejected", "grip_state", *wrenches)
    ]
    requests = f"{HAND}/accepted/{names.OPTIMIZER}/requests"
    lacking.append((names.OPTIMIZER, f"{names.OPTIMIZER} does not publish {requests}"))
    wait_until(lambda: sorted(gaps(found)) == sorted(lacking))
    unrecorded = Wiring(hand[names.ORCHESTRATOR], SCENARIO, recorded=True)
    recorded = [link.topic for link in links(SCENARIO) if link.topic not in names.USER_COMMANDS]
    lacking = [
        (names.RECORDER, f"{names.RECORDER} does not subscribe to {HAND}/{topic}")
        for topic in recorded
    ]
    wait_until(lambda: gaps(unrecorded) == lacking)


def test_publishers_and_services_are_missing_where_the_node_is(context: Context) -> None:
    """Those of another hand do not count."""
    node = new("orchestrator", context, "/right")
    wiring = Wiring(node, SCENARIO, recorded=False)
    found = gaps(wiring)
    assert found[:5] == [
        (name, f"{name} does not offer the service /right/{service}")
        for name, service in (
            (names.PLANT, "plant/run"),
            (names.CONTROLLER, "manipulation_controller/enable"),
            (names.PLANT, "plant/reset"),
            (names.REGULATOR, "slip_regulator/reset"),
            (names.CONTROLLER, "manipulation_controller/reset"),
        )
    ]
    assert (names.PLANT, "plant does not publish /right/joint_states") in found
    subscriber = f"{names.CONTROLLER} does not subscribe to /right/joint_states"
    assert (names.CONTROLLER, subscriber) in found
    assert "/left" not in str(found)
    node.destroy_node()


def test_a_second_node_of_the_same_name_is_an_error(context: Context) -> None:
    nodes = [new(names.PLANT, context, "/twice") for _ in range(2)]
    for node in nodes:
        node.create_publisher(Empty, names.JOINT_STATES, 1)
    wait_until(lambda: nodes[0].count_publishers(names.JOINT_STATES) == 2)
    with pytest.raises(DuplicateNodeError, match="'/twice/plant' runs already"):
        gaps(Wiring(nodes[0], SCENARIO, recorded=False))
    for node in nodes:
        node.destroy_node()
