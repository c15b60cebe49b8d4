# SPDX-License-Identifier: Apache-2.0
"""The base of all nodes: rhythm, peers, guarded callbacks; one node that nothing spins."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64
from support.spinning import spinning

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import ERROR, OK
from tactile_hand_ros.ros.endpoints import subscribe_directly
from tactile_hand_ros.ros.middleware import isolated_domain, private_context
from tactile_hand_ros.ros.node import TactileNode, peer_count
from tactile_hand_ros.ros.processes import wait_until


class Gains(Config):
    """Two live numbers."""

    gain: float = param(1.0, "Gain", ge=0.0, live=True)
    other: float = param(1.0, "Other", live=True)


class Example(TactileNode[Gains]):
    """A node that fails on demand."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("example", Gains, **kwargs)
        self.calls: list[Any] = []

    def on_config(self, config: Gains) -> None:
        self.calls.append(config)
        if config.gain == 13.0:
            raise TactileHandError("13 brings bad luck.")
        if config.gain == 14.0:
            raise KeyError("left")

    def check_config(self, config: Gains) -> None:
        if config.gain == 15.0:
            raise TactileHandError("15 is too much.")
        if config.gain == 16.0:
            raise KeyError("left")

    def on_report(self) -> None:
        self.calls.append("report")

    def to_safe_state(self, reason: str) -> None:
        self.calls.append(("safe", reason))

    def on_rejected(self, source: str, reason: str) -> None:
        self.calls.append((source, reason))


@pytest.fixture
def context() -> Iterator[Any]:
    with isolated_domain() as domain, private_context(domain) as made:
        yield made


@pytest.fixture
def node(context: Any) -> Iterator[Example]:
    made = Example(context=context, namespace="/left")
    yield made
    made.destroy_node()


def test_health_is_reported_when_a_peer_comes_or_goes(node: Example) -> None:
    statuses: list[DiagnosticStatus] = []
    user = Node("user", context=node.context)
    user.create_subscription(
        DiagnosticArray, names.DIAGNOSTICS, lambda m: statuses.extend(m.status), qos.user_qos()
    )
    node.create_publisher(Float64, "x", 1)
    key = "publications /left/x"

    def is_reported(count: str) -> bool:
        facts = {pair.key: pair.value for pair in statuses[-1].values} if statuses else {}
        return facts.get(key) == count

    with spinning(node, user):
        reader = user.create_subscription(Float64, "/left/x", print, 1)
        wait_until(lambda: is_reported("1"))
        user.destroy_subscription(reader)
        wait_until(lambda: is_reported("0"))
    assert {status.name for status in statuses} == {"/left/example"}
    assert node.calls[-1] == "report"
    user.destroy_node()


def test_peers_are_counted_by_topic_and_end(node: Example, context: Any) -> None:
    """Those that no executor serves as well."""
    node.create_publisher(Float64, "x", 1)
    subscribe_directly(node, Float64, "x", QoSProfile(depth=1))
    wait_until(lambda: peer_count(_texts(node.peers()), "publications", "/left/x") == 1)
    wait_until(lambda: node.peers()["subscriptions /left/x"] == 1)
    assert peer_count({}, "publications", "/left/x") == 0


def _texts(counts: dict[str, int]) -> dict[str, str]:
    return {key: str(count) for key, count in counts.items()}


def test_a_configuration_that_cannot_be_taken_over_is_a_fault_until_the_next(
    node: Example,
) -> None:
    def change(value: float) -> tuple[bool, str]:
        (result,) = node.set_parameters([Parameter("gain", value=value)])
        return result.successful, result.reason

    assert change(13.0)[0] and node.config.gain == 13.0
    status = node.diagnostics.status()
    assert (status.level, status.message) == (ERROR, "13 brings bad luck.")
    assert change(2.0)[0] and node.diagnostics.status().level == OK
    assert change(14.0)[0] and node.diagnostics.errors == {"configuration": 1}
    assert node.calls[-1][0] == "safe"
    assert change(15.0) == (False, "15 is too much.")
    successful, reason = change(16.0)
    assert not successful and reason.startswith("KeyError at ros/parameters.py:")
    assert node.config.gain == 14.0
    assert not change(-1.0)[0]


def test_a_subscription_has_a_quality_of_service_of_its_own(node: Example) -> None:
    given = QoSProfile(depth=7)
    made = node.subscribe(Float64, "x", print, profile=given, raw=True)
    assert made.qos_profile.depth == 7 and made.raw
    plain, sensor = (node.subscribe(Float64, n, print, sensor=n == "s") for n in ("p", "s"))
    assert plain.qos_profile.depth == qos.tick_qos().depth and not plain.raw
    known = set(node.get_parameters_by_prefix("qos_overrides"))
    assert known and all(name.startswith("/left/s.subscription.") for name in known)
    made.qos_profile.depth = 9
    assert given.depth == 7 and sensor.qos_profile.depth == plain.qos_profile.depth
