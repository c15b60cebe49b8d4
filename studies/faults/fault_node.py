# SPDX-License-Identifier: Apache-2.0
"""A node between a publisher and its subscribers, through which faults are injected.

``python -m studies.faults.fault_node TAP --ros-args …``. The publishers of the
topics of a tap are started with remappings to ``tapped/…``; this node passes their messages on, as
bytes, and does to some of them what it was asked for on the topic ``fault`` (std_msgs/String:
``FAULT SEED TOPIC…``; nothing ends it).
"""

from __future__ import annotations

import random
import sys
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import String

from studies.faults import taps
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.runner import run_node

CONTROL = "fault"
DELAY = 0.1
"""By how much a delayed message is late [s]."""

KEPT = 10
"""Of so many messages of a slow topic one is passed on."""

_PULSE = 0.05  # s, mean length of a pause or of a pulse of something intermittent
_LOOK = 0.001  # s between two looks at what is delayed


class FaultNode(Node):
    """Passes messages on; see the docstring of the module."""

    def __init__(self, tap: str) -> None:
        """Create a subscription and a publisher for each topic of a tap."""
        super().__init__(f"fault_node_{tap}")
        self._fault, self._topics, self._chance = "", frozenset[str](), random.Random(0)
        self._frozen: dict[str, bytes] = {}
        self._counts: dict[str, int] = {}
        self._waiting: deque[tuple[float, Any, bytes]] = deque()
        self._is_through, self._turn_at = True, 0.0
        for topic, (_, kind) in taps.tapped(tap, load_hand_config("paper").finger_names).items():
            publisher = self.create_publisher(kind, topic, qos.tick_publisher_qos())
            take = partial(self._pass, topic, kind, publisher)
            self.create_subscription(kind, taps.PREFIX + topic, take, qos.tick_qos(), raw=True)
        self.create_subscription(String, CONTROL, self._on_control, qos.user_qos())
        self.create_timer(_LOOK, self._release, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_control(self, message: String) -> None:
        fault, seed, *topics = message.data.split() or ["", "0"]
        self._fault, self._topics = fault, frozenset(topics)
        self._chance = random.Random(int(seed))
        self._frozen.clear()
        self._is_through, self._turn_at = True, 0.0

    def _pass(self, topic: str, kind: Any, publisher: Any, data: bytes) -> None:
        if topic not in self._topics:
            publisher.publish(data)
        elif self._fault == "delayed":
            self._waiting.append((time.monotonic() + DELAY, publisher, data))
        else:
            changed = self._changed(topic, kind, data)
            if changed is not None:
                publisher.publish(changed)

    def _changed(self, topic: str, kind: Any, data: bytes) -> bytes | None:
        """Return what becomes of a message of a topic that fails; None where it is lost."""
        if self._fault == "stuck":
            return taps.stuck(data, self._frozen.setdefault(topic, data))
        if self._fault == "garbage":
            return taps.garbage(data, self._chance)
        if self._fault == "wrong":
            return taps.wrong(data, kind)
        if self._fault == "clock_step":
            return taps.stepped(data)
        if self._fault == "slow":
            self._counts[topic] = (self._counts.get(topic, 0) + 1) % KEPT
            return None if self._counts[topic] else data
        if self._fault == "intermittent":
            return data if self._is_on() else None
        return None  # off

    def _is_on(self) -> bool:
        now = time.monotonic()
        if now >= self._turn_at:
            self._is_through = not self._is_through
            self._turn_at = now + self._chance.expovariate(1.0 / _PULSE)
        return self._is_through

    def _release(self) -> None:
        now = time.monotonic()
        while self._waiting and self._waiting[0][0] <= now:
            _, publisher, data = self._waiting.popleft()
            publisher.publish(data)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    program, tap, *rest = list(sys.argv if args is None else args)
    return run_node(partial(FaultNode, tap), [program, *rest])


if __name__ == "__main__":
    sys.exit(main())
