# SPDX-License-Identifier: Apache-2.0
"""A replay offers what was recorded where all publishers offered the same."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from tactile_hand_ros.nodes.replay.options import ReplayOptions, ReplayProgress
from tactile_hand_ros.nodes.replay.replay import offered_qos

INFINITE = QosTime(2147483647, 4294967295)


def offer(**changes: Any) -> Qos:
    values: dict[str, Any] = {
        "history": QosHistory.KEEP_LAST,
        "depth": 3,
        "reliability": QosReliability.RELIABLE,
        "durability": QosDurability.VOLATILE,
        "deadline": INFINITE,
        "lifespan": INFINITE,
        "liveliness": QosLiveliness.AUTOMATIC,
        "liveliness_lease_duration": INFINITE,
        "avoid_ros_namespace_conventions": False,
    }
    return Qos(**{**values, **changes})


BEST_EFFORT = offer(reliability=QosReliability.BEST_EFFORT)
LATCHED = offer(durability=QosDurability.TRANSIENT_LOCAL)


@pytest.mark.parametrize(
    ("offers", "count", "reliability", "durability", "depth"),
    [
        ([], 7, "RELIABLE", "VOLATILE", 1000),
        ([offer()], 7, "RELIABLE", "VOLATILE", 1000),
        ([BEST_EFFORT, BEST_EFFORT], 7, "BEST_EFFORT", "VOLATILE", 1000),
        ([LATCHED], 7, "RELIABLE", "TRANSIENT_LOCAL", 7),
        ([LATCHED], 0, "RELIABLE", "TRANSIENT_LOCAL", 1),
        ([LATCHED], 5000, "RELIABLE", "TRANSIENT_LOCAL", 1000),
        ([BEST_EFFORT, offer()], 7, "RELIABLE", "VOLATILE", 1000),
        ([LATCHED, offer()], 7, "RELIABLE", "VOLATILE", 1000),
    ],
)
def test_the_offer_is_that_of_all_or_a_common_one(
    offers: list[Qos], count: int, reliability: str, durability: str, depth: int
) -> None:
    profile = offered_qos(offers, count)
    assert profile.history == HistoryPolicy.KEEP_LAST and profile.depth == depth
    assert profile.reliability == ReliabilityPolicy[reliability]
    assert profile.durability == DurabilityPolicy[durability]


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        (INFINITE, None),
        (QosTime(9223372036, 854775807), None),
        (QosTime(2**31 - 2, 0), Duration(seconds=2**31 - 2)),
        (QosTime(0, 0), None),
        (QosTime(0, 1), Duration(nanoseconds=1)),
        (QosTime(1, 0), Duration(seconds=1)),
        (QosTime(3, 500_000_000), Duration(seconds=3, nanoseconds=500_000_000)),
    ],
)
@pytest.mark.parametrize("name", ["deadline", "lifespan"])
def test_a_time_limit_is_kept_unless_there_is_none(
    name: str, limit: QosTime, expected: Duration | None
) -> None:
    found = getattr(offered_qos([offer(**{name: limit})], 1), name)
    without = getattr(offered_qos([], 1), name)
    assert found == (without if expected is None else expected)


def test_of_several_publishers_the_limits_of_the_first_are_kept() -> None:
    offers = [offer(deadline=QosTime(1, 0)), offer(deadline=QosTime(2, 0))]
    assert offered_qos(offers, 1).deadline == Duration(seconds=1)


def test_by_default_a_bag_is_replayed_as_it_was_recorded() -> None:
    assert vars(ReplayOptions()) == {
        "rate": 1.0,
        "start_offset": 0.0,
        "loop": False,
        "topics": (".*",),
        "exclude": (),
        "clock": 0.0,
        "namespace": "",
        "paused": False,
        "delay": 0.0,
    }
    begin = {"position": 0.0, "duration": 0.0, "messages": 0, "paused": False, "late": 0.0}
    assert vars(ReplayProgress()) == begin
