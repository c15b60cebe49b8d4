# SPDX-License-Identifier: Apache-2.0
"""The nodes publish and subscribe to what the orchestrator waits for."""

from __future__ import annotations

from typing import Any

import pytest
from support.nodes import Process

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, flatten, leaves
from tactile_hand_ros.nodes.composed import MEMBERS
from tactile_hand_ros.orchestrator.graph import expected_topics
from tactile_hand_ros.ros.parameters import to_ros
from tactile_hand_ros.ros.qos import tick_publisher_qos
from tactile_hand_ros.scenario.scenario import load_scenario

EVERYWHERE = {"/diagnostics", "/parameter_events", "/rosout"}


def parameters(config: Config) -> dict[str, Any]:
    fields = leaves(type(config))
    values = {name: to_ros(fields[name], value) for name, value in flatten(config).items()}
    return {name: value for name, value in values.items() if value != []}  # of no type


@pytest.mark.parametrize(
    ("scenario", "changes"),
    [
        ("paper", {}),
        ("pull", {}),  # shapes f* by the cones and observes the load
        ("pinch", {"calibration.link_lengths": 1.01}),  # the sensor needs the joints then
    ],
)
def test_each_node_has_the_ends_that_the_links_of_its_scenario_say(
    scenario: str, changes: dict[str, Any], here: Process
) -> None:
    wanted = load_scenario(scenario, changes)
    configs: dict[str, Config] = {
        names.PLANT: wanted.plant.changed({"autostart": False}),
        names.SENSOR: wanted.tactile_sensor,
        names.REGULATOR: wanted.slip_regulator,
        names.OPTIMIZER: wanted.force_optimizer,
        names.CONTROLLER: wanted.manipulation_controller,
    }
    nodes = [
        here.make(kind, composed=False, **parameters(configs[_name(kind)])) for kind in MEMBERS
    ]
    sent = {
        (publisher.topic_name[1:], node.get_name(), _is_tick(publisher))
        for node in nodes
        for publisher in node.publishers
        if publisher.topic_name not in EVERYWHERE
    }
    taken = {
        (each.topic_name[1:], node.get_name()) for node in nodes for each in node.subscriptions
    }
    expected = expected_topics(wanted)
    assert taken == {(link.topic, name) for link in expected for name in link.subscribers}
    from_users = {*names.USER_COMMANDS}
    assert sent == {
        (link.topic, link.publisher, link.each_tick)
        for link in expected
        if link.topic not in from_users
    }


def _name(kind: type) -> str:
    return kind.__module__.split(".")[2]


def _is_tick(publisher: Any) -> bool:
    return bool(publisher.qos_profile == tick_publisher_qos())


def test_composed_nodes_receive_only_what_users_send(here: Process) -> None:
    received = {
        each.topic_name[1:]
        for kind in MEMBERS
        for each in here.make(
            kind, **({"cones": True} if "optimizer" in _name(kind) else {})
        ).subscriptions
    }
    assert received == {names.DESIRED_POSE, names.USER_GRASP_FORCE}
