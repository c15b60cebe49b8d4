# SPDX-License-Identifier: Apache-2.0
"""Who must talk to whom before a run may begin, and who is still missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import CONTROLLER, PLANT, RECORDER, REGULATOR, USER_COMMANDS
from tactile_hand_ros.orchestrator.topology import Link, links
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS, peer_count
from tactile_hand_ros.scenario.scenario import Scenario


class DuplicateNodeError(TactileHandError):
    """A node of the same name runs already."""

    @classmethod
    def of(cls, name: str) -> DuplicateNodeError:
        """Build the error for the full name of a node."""
        return cls(
            f"a node called '{name}' runs already in this ROS domain; stop the other run, or give"
            " this one another --namespace or ROS_DOMAIN_ID"
        )


Facts = Mapping[str, Mapping[str, str]]
"""The values in the diagnostics of nodes, by full name of the node."""


@dataclass(frozen=True)
class Gap:
    """Something that a node does not offer yet."""

    node: str
    text: str


def services() -> list[tuple[str, str]]:
    """Return nodes and their services, both relative to the namespace."""
    resettable = (PLANT, REGULATOR, CONTROLLER)
    return [
        (PLANT, f"{PLANT}/run"),
        (CONTROLLER, f"{CONTROLLER}/enable"),
        *((node, f"{node}/reset") for node in resettable),
    ]


def _recorded(link: Link) -> Link:
    """Add the recorder, which leaves the commands of users to those who act on them."""
    recorder = () if link.topic in USER_COMMANDS else (RECORDER,)
    return Link(link.topic, link.publisher, link.subscribers + recorder)


class Wiring:
    """Compares the ROS graph with what the run needs.

    That a publisher and a subscription exist is not enough: each must have met the other, which
    only the two nodes know. They report it in their diagnostics.

    What was found once is not looked for again: a question to the graph costs the nodes that are
    starting at that moment.
    """

    def __init__(self, node: Node, scenario: Scenario, *, recorded: bool) -> None:
        """Say what is needed.

        Args:
            node: Any node in the namespace of the run.
            scenario: What is to be run.
            recorded: Whether the recorder takes part.
        """
        self._node = node
        self._namespace = node.get_namespace()
        self._links = [_recorded(link) if recorded else link for link in links(scenario)]
        self._services = services()

    def missing(self, facts: Facts) -> Iterator[Gap]:
        """Yield what is still missing; the graph is asked only as far as the caller goes on.

        Args:
            facts: What the nodes said about themselves, their peers included.

        Raises:
            DuplicateNodeError: If a node of the run is there twice.
        """
        yield from self._missing_services()
        for link in list(self._links):
            gaps = self._missing_of(link, facts)
            if not gaps:
                self._links.remove(link)
            yield from gaps

    def _missing_services(self) -> list[Gap]:
        if not self._services:
            return []
        offered = {name for name, _ in self._node.get_service_names_and_types()}
        self._services = [
            (node, name) for node, name in self._services if self._full(name) not in offered
        ]
        return [
            Gap(node, f"{node} does not offer the service {self._full(name)}")
            for node, name in self._services
        ]

    def _missing_of(self, link: Link, facts: Facts) -> list[Gap]:
        topic = self._full(link.topic)
        gaps = []
        if not self._publishes(link.publisher, topic):
            gaps.append(Gap(link.publisher, f"{link.publisher} does not publish {topic}"))
        present = self._own(self._node.get_subscriptions_info_by_topic(topic))
        gaps += [
            Gap(name, f"{name} does not subscribe to {topic}")
            for name in link.subscribers
            if name not in present
        ]
        return gaps or self._unmet(link, topic, len(present), facts)

    def _unmet(self, link: Link, topic: str, subscriptions: int, facts: Facts) -> list[Gap]:
        """Return who is there but has not met the other end."""

        def met_by(name: str, end: str) -> int:
            return peer_count(facts.get(self._full(name), {}), end, topic)

        met = met_by(link.publisher, PUBLICATIONS)
        gaps = [
            Gap(name, f"{name} has not met the publisher of {topic}")
            for name in link.subscribers
            if not met_by(name, SUBSCRIPTIONS)
        ]
        if met < subscriptions:
            text = f"{link.publisher} has met {met} of {subscriptions} subscribers of {topic}"
            gaps.append(Gap(link.publisher, text))
        return gaps

    def _publishes(self, name: str, topic: str) -> bool:
        count = self._own(self._node.get_publishers_info_by_topic(topic)).count(name)
        if count > 1:
            raise DuplicateNodeError.of(self._full(name))
        return count == 1

    def _own(self, endpoints: Sequence[TopicEndpointInfo]) -> list[str]:
        """Return the names of the nodes in the run's namespace that the endpoints belong to."""
        return [each.node_name for each in endpoints if each.node_namespace == self._namespace]

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._namespace.rstrip('/')}/{name}"
