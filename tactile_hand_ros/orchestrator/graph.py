# SPDX-License-Identifier: Apache-2.0
"""Find out what a run still waits for before it can start, from the nodes' diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rclpy.node import Node

from tactile_hand_ros import names
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS


def missing_endpoints(
    node: Node, members: Sequence[str], facts: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[str, str]]:
    """Yield each missing endpoint: the name of a node, and a sentence.

    Existing endpoints are not enough: each publisher and subscription must have matched the other.
    Only the two nodes can see this, and report it in their diagnostics.

    Args:
        node: Any node in the namespace of the run.
        members: Names of the nodes. A recorder among them must receive every topic except user
            commands; omit a recorder that shares a process with the publishers.
        facts: The values in the diagnostics of the nodes, by full name.
    """
    prefix = node.get_namespace().rstrip("/")
    reports = {name: facts.get(f"{prefix}/{name}") for name in members}
    yield from ((n, f"{n} does not report yet") for n, report in reports.items() if report is None)
    sent, received = _ends(reports, PUBLICATIONS), _ends(reports, SUBSCRIPTIONS)
    not_recorded = {f"{prefix}/{topic}" for topic in names.USER_COMMANDS}
    for topic, publishers in sent.items():
        subscribers = received.get(topic, {})
        if reports.get(names.RECORDER) is not None and topic not in not_recorded:
            subscribers.setdefault(names.RECORDER, 0)
        for name, count in subscribers.items():
            if not count:
                yield name, f"{name} does not receive {topic} yet"
        wanted = max(len(subscribers), node.count_subscribers(topic))
        for name, count in publishers.items():
            if count < wanted:
                yield name, f"{name} has matched {count} of {wanted} subscribers of {topic}"


def _ends(reports: Mapping[str, Mapping[str, str] | None], end: str) -> dict[str, dict[str, int]]:
    """Return the number of matched peers by topic and name of the node."""
    found: dict[str, dict[str, int]] = {}
    for name, values in reports.items():
        for key, count in (values or {}).items():
            kind, _, topic = key.partition(" ")
            is_hidden = f"/{names.HIDDEN}" in topic
            if kind == end and topic not in names.OF_ALL and not is_hidden:
                found.setdefault(topic, {})[name] = int(count)
    return found
