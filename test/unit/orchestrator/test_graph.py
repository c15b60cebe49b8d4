# SPDX-License-Identifier: Apache-2.0
"""A run waits until all its nodes report that they have matched each other."""

from collections.abc import Iterator

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Empty

from bench.processes import isolated_domain
from tactile_hand_ros import names
from tactile_hand_ros.orchestrator.graph import missing_endpoints
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import wait_until

PLANT, SENSOR, RECORDER, USER = names.PLANT, names.SENSOR, names.RECORDER, names.ORCHESTRATOR
MEMBERS = [PLANT, SENSOR, USER]
HAND = "/left"
Facts = dict[str, dict[str, str]]


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    with isolated_domain() as domain, ros_context(domain=domain) as made:
        yield made


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    made = Node(USER, context=context, namespace=HAND, start_parameter_services=False)
    yield made
    made.destroy_node()


def all_matched(*, composed: bool = False, recorder: bool = False) -> Facts:
    """Return the reports of fully matched nodes: two topics, and commands of a user."""
    inside, taps = int(not composed), int(recorder)
    contacts, clock, pose = (f"{HAND}/{t}" for t in ("contacts", "clock", names.DESIRED_POSE))
    facts = {
        PLANT: {
            f"publications {contacts}": inside + taps,
            f"publications {clock}": taps,
            f"subscriptions {pose}": 1,
            "publications /diagnostics": 0,
            "mode": "paused",
        },
        SENSOR: {f"subscriptions {contacts}": 1} if inside else {},
        USER: {f"publications {pose}": 1},
    }
    if recorder:
        facts[RECORDER] = {f"subscriptions {contacts}": 1, f"subscriptions {clock}": 1}
    return {
        f"{HAND}/{name}": {key: str(value) for key, value in values.items()}
        for name, values in facts.items()
    }


def missing(node: Node, facts: Facts, members: list[str] = MEMBERS) -> list[tuple[str, str]]:
    return list(missing_endpoints(node, members, facts))


@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize("recorder", [False, True])
def test_nothing_is_missing_where_all_have_matched(node, composed, recorder):
    members = [*MEMBERS, RECORDER] if recorder else MEMBERS
    facts = all_matched(composed=composed, recorder=recorder)
    assert missing(node, facts, members) == []


def test_a_recorder_receives_every_topic_but_the_commands_of_users(node):
    facts, members = all_matched(recorder=True), [*MEMBERS, RECORDER]
    facts[f"{HAND}/{RECORDER}"] = {}
    assert [text for name, text in missing(node, facts, members) if name == RECORDER] == [
        f"recorder does not receive {HAND}/{topic} yet" for topic in ("contacts", "clock")
    ]


def test_a_recorder_in_the_process_of_the_nodes_is_not_waited_for(node):
    facts = all_matched(composed=True)
    facts[f"{HAND}/{RECORDER}"] = {f"subscriptions {HAND}/clock": "1"}
    assert missing(node, facts) == []


def test_a_node_that_has_not_matched_is_named(node):
    facts, topic = all_matched(), f"{HAND}/contacts"
    facts[f"{HAND}/{PLANT}"][f"publications {topic}"] = "0"
    facts[f"{HAND}/{SENSOR}"][f"subscriptions {topic}"] = "0"
    assert missing(node, facts) == [
        (SENSOR, f"{SENSOR} does not receive {topic} yet"),
        (PLANT, f"{PLANT} has matched 0 of 1 subscribers of {topic}"),
    ]


@pytest.mark.parametrize("absent", MEMBERS)
def test_a_node_that_has_not_reported_is_missing(node, absent):
    facts = all_matched()
    del facts[f"{HAND}/{absent}"]
    assert (absent, f"{absent} does not report yet") in missing(node, facts)


def test_a_subscriber_from_outside_must_be_matched_too(node, context):
    viewer = Node("viewer", context=context, namespace=HAND)
    viewer.create_subscription(Empty, names.CLOCK, print, 1)
    topic = f"{HAND}/clock"
    wait_until(lambda: node.count_subscribers(topic) == 1)
    assert missing(node, all_matched()) == [
        (PLANT, f"plant has matched 0 of 1 subscribers of {topic}")
    ]
    viewer.destroy_node()
