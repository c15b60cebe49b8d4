# SPDX-License-Identifier: Apache-2.0
"""Quality of service of ticks, latched values and user commands.

Unless stated otherwise, rclpy's defaults apply: keep the last `depth` messages, reliable, volatile.
"""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

USER_DEPTH = 100
"""Messages kept of user commands and of topics that users must not miss."""

PUBLISHED_DEPTH = 3000
"""Messages that a publisher keeps per tick topic: 6 s at 500 Hz, for a recorder that lags.
In lockstep all nodes wait for each other, but none waits for the recorder."""

HEARTBEAT = 0.1
"""Time after which a lost message is sent again [s], `heartbeatPeriod` in config/middleware."""


def tick_qos() -> QoSProfile:
    """Return the profile of tick messages: 0.2 s at 500 Hz, more than any consumer may lag.

    Each call returns a new object, because rclpy writes QoS overrides into the given profile.
    """
    return QoSProfile(depth=100)


def tick_publisher_qos() -> QoSProfile:
    """Return the profile of tick publishers: `tick_qos` with a deeper history."""
    return QoSProfile(depth=PUBLISHED_DEPTH)


def latched_qos(depth: int = 1) -> QoSProfile:
    """Return the profile of values for late subscribers too: reliable, transient local."""
    return QoSProfile(depth=depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def user_qos() -> QoSProfile:
    """Return the profile of messages from and to users and tools: reliable, depth 100."""
    return QoSProfile(depth=USER_DEPTH)
