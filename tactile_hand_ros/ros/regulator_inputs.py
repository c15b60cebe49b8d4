# SPDX-License-Identifier: Apache-2.0
"""What the slip regulator hears: contacts and the force of every finger, of one tick."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.ros import interfaces
from tactile_hand_ros.ros.matching import REPEAT, StampMatcher
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.wire import ContactsCodec, WrenchCodec


class RegulatorListener(Protocol):
    """Who answers ticks."""

    def on_tick(self, stamp: int, contacts: Contacts, forces: NDArray[np.float64]) -> None:
        """Answer a tick; forces in contact frames, shape (k, 3), N."""

    def on_repeat(self) -> None:
        """Give the last answer again."""

    def on_restart(self) -> None:
        """Forget the past: ticks begin anew."""


class RegulatorInputs:
    """Subscribes to touch and joins what belongs to one stamp."""

    def __init__(
        self, node: TactileNode[Any], fingers: Sequence[str], listener: RegulatorListener
    ) -> None:
        """Create the subscriptions.

        Args:
            node: The node.
            fingers: Names of the fingers.
            listener: Gets the ticks.
        """
        self._listener = listener
        topics = [interfaces.wrench(name) for name in fingers]
        keys = (interfaces.CONTACTS, *topics)
        self._matcher = StampMatcher(keys, on_restart=listener.on_restart)
        self._contacts = ContactsCodec(len(fingers))
        subscribe = partial(node.subscribe, sensor=True, raw=True)
        subscribe(PoseArray, interfaces.CONTACTS, self._on_contacts)
        for name, topic in zip(fingers, topics, strict=True):
            codec = WrenchCodec(interfaces.contact_frame(name))
            subscribe(WrenchStamped, topic, partial(self._on_wrench, topic, codec))

    def _on_contacts(self, data: bytes) -> None:
        stamp, poses = self._contacts.decode(data)
        self._take(interfaces.CONTACTS, stamp, Contacts.from_poses(*poses))

    def _on_wrench(self, topic: str, codec: WrenchCodec, data: bytes) -> None:
        stamp, force = codec.decode(data)
        self._take(topic, stamp, force)

    def _take(self, key: str, stamp: int, value: Any) -> None:
        matched = self._matcher.put(key, stamp, value)
        if matched is REPEAT:
            self._listener.on_repeat()
        elif matched is not None:
            contacts, *forces = matched
            self._listener.on_tick(stamp, contacts, np.array(forces))
