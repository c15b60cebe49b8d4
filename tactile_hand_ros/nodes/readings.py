# SPDX-License-Identifier: Apache-2.0
"""Contacts and contact forces of all fingers on their topics, true or measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseArray, WrenchStamped

from tactile_hand_ros import names
from tactile_hand_ros.ros.messages.wire import ContactsCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.simulation.skin import TactileReading


class ReadingPublisher:
    """Publishes a `TactileReading`: one PoseArray, and one WrenchStamped per finger."""

    def __init__(
        self,
        node: TactileNode[Any],
        fingers: Sequence[str],
        contacts_topic: str,
        wrench_topic: Callable[[str], str],
    ) -> None:
        """Create the publishers.

        Args:
            node: The node that publishes.
            fingers: Names of the fingers, in the order of the reading's rows.
            contacts_topic: Topic of the contact frames.
            wrench_topic: Gives the topic of a finger's force.
        """
        self._contacts = ContactsCodec(len(fingers))
        self._contacts_publisher = node.tick_publisher(PoseArray, contacts_topic)
        self._wrenches = [WrenchCodec(names.contact_frame(name)) for name in fingers]
        self._wrench_publishers = [
            node.tick_publisher(WrenchStamped, wrench_topic(name)) for name in fingers
        ]
        self._sent: list[bytes] = []

    def publish(self, reading: TactileReading, stamp_ns: int) -> None:
        """Publish what touch says at a tick [ns]."""
        contacts = self._contacts.encode(reading.positions, reading.quaternions, stamp_ns)
        # At once: who solves (13) can begin while the forces are still being written.
        self._contacts_publisher.publish(contacts)
        self._sent = [contacts]
        forces = reading.forces.tolist()
        pairs = zip(self._wrenches, self._wrench_publishers, forces, strict=True)
        for codec, publisher, force in pairs:
            message = codec.encode(force, stamp_ns)
            publisher.publish(message)
            self._sent.append(message)

    def repeat(self) -> None:
        """Publish the last tick again, byte by byte."""
        publishers = (self._contacts_publisher, *self._wrench_publishers)
        for publisher, message in zip(publishers, self._sent, strict=bool(self._sent)):
            publisher.publish(message)
