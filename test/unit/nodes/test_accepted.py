# SPDX-License-Identifier: Apache-2.0
"""What a node accepts or rejects is published with its tick, over real DDS in this process."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.serialization import deserialize_message

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.nodes.user_changes import AppliedChanges
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import OK
from tactile_hand_ros.ros.endpoints import subscribe_directly, taken
from tactile_hand_ros.ros.messages import stamp_to_ns
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.processes import wait_until


class Gains(Config):
    """One number."""

    gain: float = param(1.0, "Gain", ge=0.0, live=True)


class Stage:
    """A node that accepts, and what it publishes."""

    def __init__(self, context: Any) -> None:
        self.node = TactileNode("hand", Gains, context=context, namespace="/left")
        self.accepted = AppliedChanges(self.node, "hand", requests=True, commands=True)
        listened = {
            names.accepted_parameters("hand"): (ParameterEvent, qos.configuration_qos()),
            names.accepted_requests("hand"): (DiagnosticArray, qos.user_qos()),
            names.rejected("hand"): (DiagnosticArray, qos.user_qos()),
        }
        self._subscriptions = {
            topic: subscribe_directly(self.node, kind, topic, profile)
            for topic, (kind, profile) in listened.items()
        }
        self._sent = [p for p in self.node.publishers if p.topic_name[6:] in listened]
        wait_until(lambda: all(p.get_subscription_count() for p in self._sent))

    def heard(self, topic: str) -> list[Any]:
        for publisher in self._sent:
            assert publisher.wait_for_all_acked()
        subscription = self._subscriptions[topic]
        kind = subscription.msg_type
        return [deserialize_message(data, kind) for data, _ in taken(subscription)]


@pytest.fixture
def stage() -> Iterator[Stage]:
    with isolated_domain() as domain, private_context(domain) as context:
        made = Stage(context)
        yield made
        made.node.destroy_node()


PARAMETERS, REQUESTS = names.accepted_parameters("hand"), names.accepted_requests("hand")
REJECTED = names.rejected("hand")


def test_a_configuration_takes_effect_at_the_next_tick_and_once(stage: Stage) -> None:
    stage.accepted.configuration(Gains(gain=2.0))
    stage.accepted.begin(Gains(gain=3.0))  # what was waiting is forgotten
    assert stage.heard(PARAMETERS) == []
    for stamp in (1_500_000_000, 2_000_000_000):
        stage.accepted.take_effect(stamp)
    (event,) = stage.heard(PARAMETERS)
    assert (stamp_to_ns(event.stamp), event.node) == (1_500_000_000, "/left/hand")
    changed = {each.name: each.value.double_value for each in event.changed_parameters}
    assert changed == {"gain": 3.0}


@pytest.mark.parametrize(("value", "text"), [(True, "true"), (False, "false"), (None, "")])
def test_a_request_is_named_with_its_value(stage: Stage, value: bool | None, text: str) -> None:
    stage.accepted.request("grasp", value)
    stage.accepted.take_effect(7)
    (message,) = stage.heard(REQUESTS)
    assert stamp_to_ns(message.header.stamp) == 7
    (status,) = message.status
    assert (status.name, status.message, status.level) == ("hand", "grasp", OK)
    assert [(pair.key, pair.value) for pair in status.values] == [("grasp", text)]


def test_a_refusal_is_answered_at_once_with_the_last_tick_and_no_flood(stage: Stage) -> None:
    stage.accepted.rejected(names.JOINT_STATES, "no command of a user")
    stage.accepted.rejected(names.DESIRED_POSE, "out of reach")
    (first,) = stage.heard(REJECTED)
    assert stamp_to_ns(first.header.stamp) == 0
    (status,) = first.status
    assert (status.level, status.name) == (DiagnosticStatus.WARN, "hand")
    assert status.message == "out of reach"
    pairs = [(pair.key, pair.value) for pair in status.values]
    assert pairs == [(names.DESIRED_POSE, "out of reach")]
    stage.accepted.take_effect(5)
    for number in range(12):
        stage.accepted.rejected(names.USER_GRASP_FORCE, str(number))
    after = stage.heard(REJECTED)
    assert [message.status[0].message for message in after] == [str(n) for n in range(10)]
    assert {stamp_to_ns(message.header.stamp) for message in after} == {5}
    stage.accepted.take_effect(6)
    stage.accepted.rejected(names.USER_GRASP_FORCE, "again")
    assert len(stage.heard(REJECTED)) == 1
