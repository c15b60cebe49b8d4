# SPDX-License-Identifier: Apache-2.0
"""A publisher that puts its messages into the inboxes of subscriptions of its process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSCompatibility, qos_check_compatible

from tactile_hand_ros.ros.direct.inbox import Inbox, Tap, history_depth
from tactile_hand_ros.ros.direct.lean_publisher import LeanPublisher, is_latched
from tactile_hand_ros.ros.messages.serialized import serialized


class DirectPublisher(LeanPublisher):
    """A publisher that serves the subscriptions of its process itself.

    Serialized messages go to the middleware only while a subscription elsewhere matches. Message
    objects always go there too: they are rare, and then nothing else changes for them.
    """

    def join(self, noted: Callable[[], None], forget: Callable[[DirectPublisher], None]) -> None:
        """Begin to serve subscriptions of this process.

        Args:
            noted: Called when messages wait in inboxes.
            forget: Called when the publisher is destroyed.
        """
        self._noted, self._forget = noted, forget
        self._full_topic = self.topic_name
        self.inboxes: tuple[Inbox | Tap, ...] = ()
        self._is_read_here = self._is_latched
        self._kept: deque[bytes] = deque(maxlen=history_depth(self.qos_profile))

    def publish(self, msg: Any) -> None:
        """Send a message, which may be serialized, to all subscribers."""
        super().publish(msg)
        if self._is_read_here:
            self._hand_over(msg if type(msg) is bytes else serialized(msg))

    def _hand_over(self, data: bytes) -> None:
        for inbox in self.inboxes:
            inbox.put(data)
        if self._is_latched:
            self._kept.append(data)
        self._noted()

    def matches(self, inbox: Inbox | Tap) -> bool:
        """Return whether a subscription takes what this publisher offers."""
        if inbox.topic != self._full_topic:  # which has one type in a process
            return False
        wanted = inbox.subscription.qos_profile
        return bool(qos_check_compatible(self.qos_profile, wanted)[0] != QoSCompatibility.ERROR)

    def link(self, inbox: Inbox | Tap) -> None:
        """Serve one more subscription, and give it what is kept for those that come later."""
        self.inboxes = (*self.inboxes, inbox)
        self._is_read_here = True
        if is_latched(inbox.subscription.qos_profile):
            for data in self._kept:
                inbox.put(data)

    def unlink(self, inbox: Inbox | Tap) -> None:
        """Stop serving a subscription."""
        self.inboxes = tuple(each for each in self.inboxes if each is not inbox)
        self._is_read_here = bool(self.inboxes) or self._is_latched

    def get_subscription_count(self) -> int:
        """Return the number of matching subscriptions, in this process and elsewhere."""
        return int(super().get_subscription_count()) + len(self.inboxes)

    def destroy(self) -> None:
        """Leave the subscriptions and destroy the publisher."""
        self._forget(self)
        super().destroy()
