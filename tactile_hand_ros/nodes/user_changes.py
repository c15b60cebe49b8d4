# SPDX-License-Identifier: Apache-2.0
"""User commands and their outcome, published with the tick that they change.

A command, service call or parameter arrives between two ticks, and only the node knows between
which. The node therefore publishes each of them again, stamped with the first tick whose answer it
can change. A recording of these topics suffices to reproduce the node's output. For a rejected
command it publishes the reason and the last answered tick.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterEvent
from rclpy.publisher import Publisher
from rclpy.time import Time

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.parameters import to_parameters

_REJECTION_LIMIT = 10  # published rejections between two answered ticks

MessageAt = Callable[[int], Any]
"""Makes a message, or its bytes, for a tick [ns]."""


class AppliedChanges:
    """Publishes accepted changes at the first tick that they can change.

    Publications: `accepted/<node>/parameters` (rcl_interfaces/ParameterEvent: the whole
    configuration in force; at the first tick, when ticks start again and after each change;
    transient local). For nodes with user commands and services, `accepted/<node>/requests`
    (diagnostic_msgs/DiagnosticArray: one key, the service or topic, with its value) and
    `rejected/<node>` (diagnostic_msgs/DiagnosticArray: the topic of a rejected command and the
    reason).
    """

    def __init__(self, node: TactileNode[Any], name: str, *, commands: bool = False) -> None:
        """Create the publishers; the node's name in topics is defined in `names`."""
        self._name, self._full_name = name, node.get_fully_qualified_name()
        self._waiting: list[tuple[Publisher, MessageAt]] = []
        self._parameters = node.create_publisher(
            ParameterEvent, names.accepted_parameters(name), qos.latched_qos(qos.USER_DEPTH)
        )
        if commands:
            self._requests, self._rejected = (
                node.create_publisher(DiagnosticArray, topic, qos.USER_DEPTH)
                for topic in (names.accepted_requests(name), names.rejected(name))
            )
        self._states: dict[str, bool | str] = {}
        self._answered, self._rejections = 0, 0

    def begin(self, config: Config) -> None:
        """Drop changes that have not taken effect, and publish the state in force."""
        self._waiting.clear()
        self.configuration(config)
        for name, value in self._states.items():
            self.request(name, value)

    def configuration(self, config: Config) -> None:
        """Queue a changed configuration."""
        event = ParameterEvent(node=self._full_name, changed_parameters=to_parameters(config))

        def message_at(stamp_ns: int) -> ParameterEvent:
            event.stamp = Time(nanoseconds=stamp_ns).to_msg()
            return event

        self.add(self._parameters, message_at)

    def request(self, service: str, value: bool | str = "") -> None:
        """Queue a service call or a change of a latched topic, with its value."""
        text = value if isinstance(value, str) else str(value).lower()
        self.add(self._requests, lambda stamp_ns: self._about(stamp_ns, service, service, text))

    def state(self, name: str, value: bool | str) -> bool:
        """Set a state that survives a restart of the ticks, initially False or empty.

        Return whether it has changed.
        """
        if value == self._states.get(name, type(value)()):
            return False
        self._states[name] = value
        self.request(name, value)
        return True

    def rejected(self, topic: str, reason: str) -> None:
        """Publish immediately that a user command, a relative topic, was rejected."""
        if topic not in names.USER_COMMANDS:
            return
        self._rejections += 1
        if self._rejections <= _REJECTION_LIMIT:
            level = DiagnosticStatus.WARN
            self._rejected.publish(self._about(self._answered, reason, topic, reason, level))

    def _about(
        self, stamp_ns: int, text: str, key: str, value: str, level: bytes = DiagnosticStatus.OK
    ) -> DiagnosticArray:
        """Return a message about one key, stamped with a tick [ns]."""
        values = [KeyValue(key=key, value=value)]
        status = DiagnosticStatus(level=level, name=self._name, message=text, values=values)
        message = DiagnosticArray(status=[status])
        message.header.stamp = Time(nanoseconds=stamp_ns).to_msg()
        return message

    def add(self, publisher: Publisher, message_at: MessageAt) -> None:
        """Queue another message to publish at the next tick."""
        self._waiting.append((publisher, message_at))

    def take_effect(self, stamp_ns: int) -> None:
        """Publish the changes accepted since the last tick; call it after answering a tick [ns]."""
        self._answered, self._rejections = stamp_ns, 0
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            for publisher, message_at in waiting:
                publisher.publish(message_at(stamp_ns))
