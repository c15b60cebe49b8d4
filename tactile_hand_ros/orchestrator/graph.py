# SPDX-License-Identifier: Apache-2.0
"""Who publishes what to whom, and what is still missing before a run can start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rclpy.node import Node

from tactile_hand_ros import names
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.node import PUBLICATIONS, SUBSCRIPTIONS, peer_count
from tactile_hand_ros.scenario.scenario import Scenario

_ACTING = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)


@dataclass(frozen=True)
class ExpectedTopic:
    """One topic, its publisher and its subscribers.

    Attributes:
        topic: Relative name.
        publisher: A node.
        subscribers: Other nodes.
        each_tick: Whether each tick has a message of it.
    """

    topic: str
    publisher: str
    subscribers: tuple[str, ...] = ()
    each_tick: bool = True


def expected_topics(scenario: Scenario) -> list[ExpectedTopic]:
    """Return the topics between the nodes of a scenario.

    Optimizer and controller subscribe to forces only where they are configured to use them, and the
    sensor to joints only where it reports contacts by a wrong model of the hand.
    """
    fingers = load_hand_config(scenario.hand).finger_names
    observer = scenario.manipulation_controller.law.observer
    shaping = (names.OPTIMIZER,) if scenario.force_optimizer.cones else ()
    force_readers = (
        names.REGULATOR,
        *shaping,
        *((names.CONTROLLER,) if observer.time > 0.0 else ()),
    )
    joint_readers = () if scenario.calibration.is_right else (names.SENSOR,)
    per_finger = [
        topic
        for finger in fingers
        for topic in (
            ExpectedTopic(names.true_wrench(finger), names.PLANT, (names.SENSOR,)),
            ExpectedTopic(names.wrench(finger), names.SENSOR, force_readers),
            ExpectedTopic(names.optimal_force(finger), names.OPTIMIZER, (names.CONTROLLER,)),
        )
    ]
    return [
        ExpectedTopic(names.JOINT_STATES, names.PLANT, (names.CONTROLLER, *joint_readers)),
        ExpectedTopic(names.TRUE_CONTACTS, names.PLANT, (names.SENSOR,)),
        ExpectedTopic(names.TRUE_SLIP, names.PLANT, (names.SENSOR,)),
        ExpectedTopic(names.OBJECT_POSE, names.PLANT),
        _event(names.JOINT_HOLD, names.PLANT, (names.CONTROLLER,)),
        _event(names.TOUCH_REJECTED, names.CONTROLLER, (names.REGULATOR, *shaping)),
        _event(names.ROBOT_DESCRIPTION, names.PLANT),
        ExpectedTopic(names.CLOCK, names.PLANT),
        ExpectedTopic(names.CONTACTS, names.SENSOR, _ACTING),
        ExpectedTopic(names.GRASP_FORCE, names.REGULATOR, (names.CONTROLLER,)),
        ExpectedTopic(names.GRIP_STATE, names.REGULATOR, shaping),
        _event(names.HAPTIC_FEEDBACK, names.REGULATOR),
        ExpectedTopic(names.JOINT_COMMAND, names.CONTROLLER, (names.PLANT,)),
        ExpectedTopic(names.AUXILIARY_POSE, names.CONTROLLER),
        _event(names.ACCEPTED_POSE, names.CONTROLLER),
        _event(names.ACCEPTED_FORCE, names.REGULATOR),
        *(_event(names.accepted_parameters(node), node) for node in _ACTING),
        *(
            _event(names.accepted_requests(node), node)
            for node in (names.REGULATOR, *shaping, names.CONTROLLER)
        ),
        _event(names.rejected(names.REGULATOR), names.REGULATOR),
        _event(names.rejected(names.CONTROLLER), names.CONTROLLER),
        _event(names.DESIRED_POSE, names.ORCHESTRATOR, (names.CONTROLLER,)),
        _event(names.USER_GRASP_FORCE, names.ORCHESTRATOR, (names.REGULATOR,)),
        *per_finger,
    ]


def _event(topic: str, publisher: str, subscribers: tuple[str, ...] = ()) -> ExpectedTopic:
    """Return a topic that has messages now and then."""
    return ExpectedTopic(topic, publisher, subscribers, each_tick=False)


class DuplicateNodeError(TactileHandError):
    """A node of the same name runs already."""

    @classmethod
    def of(cls, name: str) -> DuplicateNodeError:
        """Build the error for the full name of a node."""
        return cls(
            f"a node called '{name}' runs already in this ROS domain; stop the other run, or give"
            " this one another --namespace or ROS_DOMAIN_ID"
        )


@dataclass(frozen=True)
class MissingEndpoint:
    """Something that a node does not offer yet."""

    node: str
    text: str


class GraphReadiness:
    """Compares the ROS graph with what a run needs.

    That a publisher and a subscription exist is not enough: each must have matched the other, which
    only the two nodes know. They report it in their diagnostics. What was found is not checked
    again.
    """

    def __init__(self, node: Node, scenario: Scenario, *, composed: bool, recorder: bool) -> None:
        """List what is needed.

        Args:
            node: Any node in the namespace of the run.
            scenario: What is to be run.
            composed: Whether the nodes share a process, which needs no subscriptions inside.
            recorder: Whether a recorder runs in its own process. It does not subscribe to the
                commands of users.
        """
        self._node = node
        self._namespace = node.get_namespace()
        self._waiting: dict[ExpectedTopic, tuple[str, ...]] = {}
        for each in expected_topics(scenario):
            inside = composed and each.publisher != names.ORCHESTRATOR
            recorded = recorder and each.topic not in names.USER_COMMANDS
            self._waiting[each] = (() if inside else each.subscribers) + (
                (names.RECORDER,) if recorded else ()
            )

    def missing(self, facts: Mapping[str, Mapping[str, str]]) -> Iterator[MissingEndpoint]:
        """Yield what is still missing.

        Args:
            facts: The values in the diagnostics of the nodes, by full name.

        Raises:
            DuplicateNodeError: If a node of the run exists twice.
        """
        self._refuse_duplicates()
        for expected, subscribers in list(self._waiting.items()):
            found = list(self._missing_of(expected, subscribers, facts))
            if not found:
                del self._waiting[expected]
            yield from found

    def _missing_of(
        self,
        expected: ExpectedTopic,
        subscribers: tuple[str, ...],
        facts: Mapping[str, Mapping[str, str]],
    ) -> Iterator[MissingEndpoint]:
        topic = self._full(expected.topic)

        def matched(node: str, end: str) -> int:
            return peer_count(facts.get(self._full(node), {}), end, topic)

        for name in subscribers:
            if not matched(name, SUBSCRIPTIONS):
                yield MissingEndpoint(name, f"{name} does not receive {topic} yet")
        wanted = max(len(subscribers), self._node.count_subscribers(topic))
        count = matched(expected.publisher, PUBLICATIONS)
        reports = facts.get(self._full(expected.publisher), {})
        if count < wanted or f"{PUBLICATIONS} {topic}" not in reports:
            text = f"{expected.publisher} has matched {count} of {wanted} subscribers of {topic}"
            yield MissingEndpoint(expected.publisher, text)

    def _refuse_duplicates(self) -> None:
        present = [
            name
            for name, namespace in self._node.get_node_names_and_namespaces()
            if namespace == self._namespace
        ]
        for name in {each.publisher for each in self._waiting}:
            if present.count(name) > 1:
                raise DuplicateNodeError.of(self._full(name))

    def _full(self, name: str) -> str:
        return f"{self._namespace.rstrip('/')}/{name}"
