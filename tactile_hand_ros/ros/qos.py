# SPDX-License-Identifier: Apache-2.0
"""Quality of service of ticks, latched values and user commands.

rclpy takes a depth alone as a profile: keep that many last messages, reliable, volatile.
"""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

TICK_DEPTH = 100
"""Messages of ticks that a consumer may lag: 0.2 s at 500 Hz."""

USER_DEPTH = 100
"""Messages kept of user commands and of topics that users must not miss."""

PUBLISHED_DEPTH = 3000
"""Messages that a publisher keeps per tick topic: 6 s at 500 Hz, for a recorder that lags.
In lockstep all nodes wait for each other, but none waits for the recorder."""

HEARTBEAT = 0.1
"""Time after which a lost message is sent again [s], `heartbeatPeriod` in config/middleware."""


def latched_qos(depth: int = 1) -> QoSProfile:
    """Return the profile of values for late subscribers too: reliable, transient local."""
    return QoSProfile(depth=depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
