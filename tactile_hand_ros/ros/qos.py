# SPDX-License-Identifier: Apache-2.0
"""Quality of service of ticks, of latched values and of what users send.

What is not said is rclpy's default: keep the last `depth` messages, reliable, volatile.
"""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

TICK_DEPTH = 100
"""Messages kept per tick topic: 0.2 s at 500 Hz, more than any consumer may lag behind."""

USER_DEPTH = 100
"""Messages kept of what users send, and of what they must not miss."""

PUBLISHED_DEPTH = 3000
"""Messages that a publisher keeps of a tick topic: 6 s at 500 Hz, for a recorder that fell behind.
In lockstep all nodes wait for each other, but none waits for the recorder."""


def tick_qos() -> QoSProfile:
    """Return the profile of everything that carries a tick: reliable, deep, volatile.

    A new object each time, because rclpy writes QoS overrides into the profile it is given.
    """
    return QoSProfile(depth=TICK_DEPTH)


def tick_publisher_qos() -> QoSProfile:
    """Return the profile with which ticks are published: as `tick_qos`, with a longer memory."""
    return QoSProfile(depth=PUBLISHED_DEPTH)


def latched_qos(depth: int = 1) -> QoSProfile:
    """Return the profile of values that late subscribers must get: reliable, transient local."""
    return QoSProfile(depth=depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def user_qos() -> QoSProfile:
    """Return the profile of what a user or tool sends and watches: reliable, depth 100."""
    return QoSProfile(depth=USER_DEPTH)
