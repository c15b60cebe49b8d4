# SPDX-License-Identifier: Apache-2.0
"""Each node subscribes to its inputs and publishes the outputs that others need, once per tick."""

from typing import Any

import pytest
from rclpy.qos import QoSProfile

from bench.wire import each_tick
from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, flatten
from tactile_hand_ros.nodes.composed import MEMBERS
from tactile_hand_ros.ros.parameters import to_ros
from tactile_hand_ros.ros.qos import PUBLISHED_DEPTH
from tactile_hand_ros.scenario.scenario import load_scenario

FINGERS = ("finger_1", "finger_2", "finger_3")
ASKED = {
    names.PLANT: {"push"},
    names.REGULATOR: {"joint_hold", "touch_rejected", "user_grasp_force"},
    names.CONTROLLER: {"joint_hold", "desired_pose"},
}
"""What nodes receive besides the topics of a tick."""


def parameters(config: Config) -> dict[str, Any]:
    values = {name: to_ros(value) for name, value in flatten(config).items()}
    return {name: value for name, value in values.items() if value != []}  # of no type


@pytest.mark.parametrize(
    ("scenario", "changes", "more"),
    [
        ("paper", {}, {}),
        (  # shapes f* by the cones, and observes the load
            "pull",
            {},
            {
                names.OPTIMIZER: {"grasp_force", "grip_margin", *map(names.load, FINGERS)},
                names.CONTROLLER: set(map(names.wrench, FINGERS)),
            },
        ),
        (  # a miscalibrated hand: the sensor computes the contacts from the joints
            "paper",
            {"calibration.link_lengths": 1.01},
            {names.SENSOR: {"joint_states"}},
        ),
    ],
)
def test_a_node_subscribes_to_what_it_is_configured_to_use(scenario, changes, more, here):
    wanted = load_scenario(scenario, {**changes, "plant.autostart": False})
    each_tick_qos = QoSProfile(depth=PUBLISHED_DEPTH)
    for kind in MEMBERS:
        name = _name(kind)
        node = here.make(kind, composed=False, **parameters(getattr(wanted, name)))
        received = {each.topic_name[1:] for each in node.subscriptions}
        read = {link.topic for link in each_tick() if name in link.subscribers}
        assert received == read | ASKED.get(name, set()) | more.get(name, set())
        sent = {p.topic_name[1:] for p in node.publishers if p.qos_profile == each_tick_qos}
        assert sent == {link.topic for link in each_tick() if link.publisher == name}


def _name(kind: type) -> str:
    return kind.__module__.split(".")[2]


def test_composed_nodes_receive_only_what_users_send(here):
    received = set[str]()
    for kind in MEMBERS:
        options = {"cones": True} if "optimizer" in _name(kind) else {}
        received |= {each.topic_name[1:] for each in here.make(kind, **options).subscriptions}
    assert received == {names.DESIRED_POSE, names.USER_GRASP_FORCE, names.PUSH}
