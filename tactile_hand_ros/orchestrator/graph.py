# SPDX-License-Identifier: Apache-2.0
"""What is still missing before a run can start, by what its nodes report about themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rclpy.node import Node

from tactile_hand_ros import names
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS

_OF_ALL = (names.DIAGNOSTICS, "/parameter_events", "/rosout")
"""Topics that every node has."""


class DuplicateNodeError(TactileHandError):
    """A node of the same name already runs."""


@dataclass(frozen=True)
class MissingEndpoint:
    """Something that a node does not offer yet."""

    node: str
    text: str


class GraphReadiness:
    """Checks that all nodes of a run are there and have matched each other.

    That a publisher and a subscription exist is not enough: each must have matched the other, which
    only the two nodes know. Each node reports its own in its diagnostics.
    """

    def __init__(self, node: Node, members: Sequence[str]) -> None:
        """Remember who takes part.

        Args:
            node: Any node in the namespace of the run.
            members: Names of the nodes. A recorder among them must receive every topic but the
                commands of users; leave out one that shares a process with the publishers.
        """
        self._node = node
        self._namespace = node.get_namespace()
        self._members = {self._full(name): name for name in members}
        self._recorder = self._full(names.RECORDER)
        self._not_recorded = {*_OF_ALL, *map(self._full, names.USER_COMMANDS)}

    def missing(self, facts: Mapping[str, Mapping[str, str]]) -> Iterator[MissingEndpoint]:
        """Yield what is still missing.

        Args:
            facts: The values in the diagnostics of the nodes, by full name.

        Raises:
            DuplicateNodeError: If a node of the run exists twice.
        """
        self._refuse_duplicates()
        for full, name in self._members.items():
            if full not in facts:
                yield MissingEndpoint(name, f"{name} does not report yet")
        reports = {full: facts[full] for full in self._members if full in facts}
        sent, received = _ends(reports, PUBLICATIONS), _ends(reports, SUBSCRIPTIONS)
        for topic in sent:
            subscribers = received.get(topic, {})
            if self._recorder in reports and topic not in self._not_recorded:
                subscribers.setdefault(self._recorder, 0)
            for full, count in subscribers.items():
                if not count:
                    name = self._members[full]
                    yield MissingEndpoint(name, f"{name} does not receive {topic} yet")
            wanted = max(len(subscribers), self._node.count_subscribers(topic))
            for full, count in sent[topic].items():
                if count < wanted:
                    name = self._members[full]
                    text = f"{name} has matched {count} of {wanted} subscribers of {topic}"
                    yield MissingEndpoint(name, text)

    def _refuse_duplicates(self) -> None:
        present = [
            self._full(name)
            for name, namespace in self._node.get_node_names_and_namespaces()
            if namespace == self._namespace
        ]
        for full in self._members:
            if present.count(full) > 1:
                raise DuplicateNodeError(
                    f"a node called '{full}' already runs in this ROS domain; stop the other run, "
                    "or give this one another --namespace or ROS_DOMAIN_ID"
                )

    def _full(self, name: str) -> str:
        return f"{self._namespace.rstrip('/')}/{name}"


def _ends(reports: Mapping[str, Mapping[str, str]], end: str) -> dict[str, dict[str, int]]:
    """Return how many peers each node has matched, by topic and full name of the node."""
    found: dict[str, dict[str, int]] = {}
    for full, values in reports.items():
        for key, count in values.items():
            kind, _, topic = key.partition(" ")
            if kind == end and topic not in _OF_ALL:
                found.setdefault(topic, {})[full] = int(count)
    return found
