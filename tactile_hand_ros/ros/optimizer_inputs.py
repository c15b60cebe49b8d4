# SPDX-License-Identifier: Apache-2.0
"""What the force optimizer hears: contacts, and with cones also forces and grip, of one tick."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from tactile_hand_ros.core.contact import Contacts
from tactile_hand_ros.ros import interfaces
from tactile_hand_ros.ros.matching import REPEAT, StampMatcher
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.wire import ContactsCodec, GripCodec, WrenchCodec

Array = NDArray[np.float64]


class Felt(NamedTuple):
    """What cones are made of.

    Attributes:
        forces: Measured forces in contact frames, shape (k, 3), N.
        friction: Learned friction of each contact, shape (k,).
    """

    forces: Array
    friction: Array


class OptimizerListener(Protocol):
    """Who answers ticks."""

    def on_tick(self, stamp: int, contacts: Contacts, felt: Felt | None) -> None:
        """Answer a tick."""

    def on_repeat(self) -> None:
        """Give the last answer again."""

    def on_restart(self) -> None:
        """Forget the past: ticks begin anew."""


class OptimizerInputs:
    """Subscribes to contacts and, for cones only, to what else they need.

    Without cones an answer waits for the contacts alone, and so comes as early as it can.
    """

    def __init__(
        self,
        node: TactileNode[Any],
        fingers: Sequence[str],
        listener: OptimizerListener,
        *,
        cones: bool,
    ) -> None:
        """Create the subscriptions.

        Args:
            node: The node.
            fingers: Names of the fingers.
            listener: Gets the ticks.
            cones: Whether forces and grip belong to a tick.
        """
        self._listener = listener
        self._contacts = ContactsCodec(len(fingers))
        self._grips = GripCodec(fingers)
        wrenches = [interfaces.wrench(name) for name in fingers]
        more = (interfaces.GRIP_STATE, *wrenches) if cones else ()
        self._matcher = StampMatcher((interfaces.CONTACTS, *more), on_restart=listener.on_restart)
        subscribe = partial(node.subscribe, sensor=True, raw=True)
        subscribe(PoseArray, interfaces.CONTACTS, self._on_contacts)
        if not cones:
            return
        node.subscribe(JointState, interfaces.GRIP_STATE, self._on_grip, raw=True)
        for name, topic in zip(fingers, wrenches, strict=True):
            codec = WrenchCodec(interfaces.contact_frame(name))
            subscribe(WrenchStamped, topic, partial(self._on_wrench, topic, codec))

    def _on_contacts(self, data: bytes) -> None:
        stamp, poses = self._contacts.decode(data)
        self._take(interfaces.CONTACTS, stamp, Contacts.from_poses(*poses))

    def _on_grip(self, data: bytes) -> None:
        stamp, (friction, _, _) = self._grips.decode(data)
        self._take(interfaces.GRIP_STATE, stamp, friction)

    def _on_wrench(self, topic: str, codec: WrenchCodec, data: bytes) -> None:
        stamp, force = codec.decode(data)
        self._take(topic, stamp, force)

    def _take(self, key: str, stamp: int, value: Any) -> None:
        matched = self._matcher.put(key, stamp, value)
        if matched is REPEAT:
            self._listener.on_repeat()
        elif matched is not None:
            contacts, *felt = matched
            self._listener.on_tick(
                stamp, contacts, Felt(np.array(felt[1:]), felt[0]) if felt else None
            )
