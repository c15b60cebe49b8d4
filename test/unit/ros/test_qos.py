# SPDX-License-Identifier: Apache-2.0
"""The QoS of each kind of topic, which consumers cannot see from their side."""

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from tactile_hand_ros.ros import qos

PROFILES = {
    "tick": (qos.tick_qos, 100, DurabilityPolicy.VOLATILE),
    "tick publisher": (qos.tick_publisher_qos, 3000, DurabilityPolicy.VOLATILE),
    "latched": (qos.latched_qos, 1, DurabilityPolicy.TRANSIENT_LOCAL),
    "user": (qos.user_qos, 100, DurabilityPolicy.VOLATILE),
}


@pytest.mark.parametrize("kind", PROFILES)
def test_profiles_promise_what_the_documentation_says_and_are_new_each_time(kind):
    make, depth, durability = PROFILES[kind]
    profile: QoSProfile = make()
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.history == HistoryPolicy.KEEP_LAST
    assert (profile.depth, profile.durability) == (depth, durability)
    profile.depth = 7  # rclpy writes into it, too
    assert make().depth == depth
