# SPDX-License-Identifier: Apache-2.0
"""Quality of service is written as rosbag2 writes it."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2.metadata import parse_qos

from tactile_hand_ros.bag.qos import OfferedQos, qos_text
from tactile_hand_ros.bag.qos import parse_qos as read_qos

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


def test_every_policy_of_older_versions_has_its_number() -> None:
    """As rmw counts them; one that it does not know makes the text unreadable."""
    for policy, values in {
        "history": ["system_default", "keep_last", "keep_all", "unknown"],
        "reliability": ["system_default", "reliable", "best_effort", "unknown", "best_available"],
        "durability": [
            *("system_default", "transient_local", "volatile", "unknown", "best_available"),
        ],
        "liveliness": [
            *("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown"),
        ],
    }.items():
        lines = TEXT.splitlines()
        [at] = [i for i, line in enumerate(lines) if line.strip("- ").startswith(f"{policy}:")]
        head = lines[at].partition(":")[0]
        for number, value in enumerate([*values, None]):
            text = "\n".join([*lines[:at], f"{head}: {number}", *lines[at + 1 :]])
            found = [getattr(offer, policy) for offer in read_qos(text)]
            assert found == ([] if value is None else [value])


def test_what_is_written_is_read_back_with_every_field() -> None:
    offer = OfferedQos(
        "keep_all", 3, "best_effort", "volatile", 7, 3_000_000_008, "manual_by_topic", 9, True
    )
    assert read_qos(qos_text([offer, OfferedQos()])) == (offer, OfferedQos())


def test_names_follow_the_conventions_of_ros_where_nothing_else_is_said() -> None:
    short = TEXT.rpartition("\n")[0]
    assert [offer.avoid_ros_namespace_conventions for offer in read_qos(short)] == [False]
    plain = QoSProfile(depth=1, avoid_ros_namespace_conventions=True)
    assert OfferedQos.from_profile(plain).avoid_ros_namespace_conventions
