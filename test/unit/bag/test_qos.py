# SPDX-License-Identifier: Apache-2.0
"""Quality of service is written as rosbag2 writes it."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2.metadata import parse_qos

from tactile_hand_ros.bag.qos import OfferedQos, qos_text

TEXT = """\
- history: unknown
  depth: 0
  reliability: best_effort
  durability: transient_local
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 1
    nsec: 500000000
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""


def test_text_of_one_offer() -> None:
    """Names instead of numbers, infinity as the largest integer, no newline at the end."""
    offer = OfferedQos(
        reliability="best_effort", durability="transient_local", lifespan=1_500_000_000
    )
    assert qos_text([offer]) == TEXT


def test_two_offers_are_two_items() -> None:
    """Each publisher has its own item; rosbags reads them."""
    parsed = parse_qos(qos_text([OfferedQos(), OfferedQos(durability="transient_local")]))
    assert [qos.durability.name for qos in parsed] == ["VOLATILE", "TRANSIENT_LOCAL"]


def test_no_offers_is_an_empty_list() -> None:
    """A topic without a known publisher."""
    assert qos_text([]) == "[]"


def test_profile_of_the_graph_is_translated() -> None:
    """All policies of an rclpy profile keep their meaning."""
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        lifespan=Duration(seconds=2),
    )
    offer = OfferedQos.from_profile(profile)
    assert (offer.history, offer.depth) == ("keep_last", 7)
    assert (offer.reliability, offer.durability) == ("best_effort", "transient_local")
    assert offer.lifespan == 2_000_000_000
