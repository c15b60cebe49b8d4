# SPDX-License-Identifier: Apache-2.0
"""What optimizer and regulator hear: contacts and, if asked, forces and grip, of one tick."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.ros.messages.wire import ContactsCodec, GripCodec, WrenchCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks.backlog import Backlog
from tactile_hand_ros.ros.ticks.matching import REPEAT, StampMatcher

Array = NDArray[np.float64]


class Touch(NamedTuple):
    """What was heard of a tick.

    Attributes:
        contacts: Contact points and frames.
        forces: Measured forces in contact frames, shape (k, 3), N; None unless asked for.
        friction: Learned friction of each contact, shape (k,); None unless asked for.
    """

    contacts: Contacts
    forces: Array | None
    friction: Array | None


class TouchListener(Protocol):
    """Who answers ticks."""

    def on_tick(self, stamp: int, touch: Touch) -> None:
        """Answer a tick."""

    def on_repeat(self) -> None:
        """Give the last answer again."""

    def on_restart(self) -> None:
        """Forget the past: ticks begin anew."""


class TouchInputs:
    """Subscribes to touch and joins what belongs to one stamp.

    What is not asked for is not waited for, so that an answer comes as early as it can.
    """

    def __init__(
        self,
        node: TactileNode[Any],
        fingers: Sequence[str],
        listener: TouchListener,
        *,
        forces: bool,
        friction: bool = False,
    ) -> None:
        """Create the subscriptions.

        Args:
            node: The node.
            fingers: Names of the fingers.
            listener: Gets the ticks.
            forces: Whether the measured forces belong to a tick.
            friction: Whether the learned friction does.
        """
        self._listener = listener
        self._contacts = ContactsCodec(len(fingers))
        self._grips = GripCodec(fingers)
        self._has_friction = friction
        felt = {names.wrench(name): name for name in fingers} if forces else {}
        grip = (names.GRIP_STATE,) if friction else ()
        keys = (names.CONTACTS, *grip, *felt)
        self._backlog: Backlog[Touch] = Backlog(node, names.CONTACTS, listener.on_tick)
        self._matcher = StampMatcher(keys, on_restart=self._restart)
        subscribe = partial(node.subscribe, sensor=True, raw=True)
        subscribe(PoseArray, names.CONTACTS, self._on_contacts)
        if friction:
            node.subscribe(JointState, names.GRIP_STATE, self._on_grip, raw=True)
        for topic, name in felt.items():
            codec = WrenchCodec(names.contact_frame(name))
            subscribe(WrenchStamped, topic, partial(self._on_wrench, topic, codec))

    def _restart(self) -> None:
        self._backlog.clear()
        self._listener.on_restart()

    def _on_contacts(self, data: bytes) -> None:
        stamp, poses = self._contacts.decode(data)
        self._take(names.CONTACTS, stamp, Contacts.from_poses(*poses))

    def _on_grip(self, data: bytes) -> None:
        stamp, (friction, _, _) = self._grips.decode(data)
        self._take(names.GRIP_STATE, stamp, friction)

    def _on_wrench(self, topic: str, codec: WrenchCodec, data: bytes) -> None:
        stamp, force = codec.decode(data)
        self._take(topic, stamp, force)

    def _take(self, key: str, stamp: int, value: Any) -> None:
        matched = self._matcher.put(key, stamp, value)
        if matched is REPEAT:
            self._backlog.repeat(self._listener.on_repeat)
        elif matched is not None:
            contacts, *rest = matched
            friction = rest.pop(0) if self._has_friction else None
            forces = np.array(rest) if rest else None
            self._backlog.put(stamp, Touch(contacts, forces, friction))
