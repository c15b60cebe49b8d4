# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml follows version 9 of rosbag2."""

from pathlib import Path

import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2.metadata import parse_qos

from tactile_hand_ros.bag.metadata import BagMetadata, TopicMetadata, dump, offered_qos

WRITTEN_BY_ROSBAG2 = Path(__file__).parents[2] / "data" / "rosbag2_metadata.yaml"
INFORMATION = yaml.safe_load(WRITTEN_BY_ROSBAG2.read_text())["rosbag2_bagfile_information"]
[OFFERED] = INFORMATION["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]


def test_file_of_a_finished_bag():
    wrench = TopicMetadata(
        "/left/wrench", "geometry_msgs/msg/WrenchStamped", (OFFERED,), "RIHS01_00ff", 5
    )
    custom = {"scenario": "paper 1"}
    metadata = BagMetadata("run_0.mcap", 1000, 25, [wrench], custom)
    written = yaml.safe_load(metadata.file_text())
    assert written == {"rosbag2_bagfile_information": INFORMATION}
    assert next(iter(written["rosbag2_bagfile_information"])) == "version"  # rosbag2 reads it first
    inside = yaml.safe_load(metadata.record()["serialized_metadata"])
    assert written == {"rosbag2_bagfile_information": inside}


@given(st.dictionaries(st.text(), st.text() | st.lists(st.integers() | st.booleans(), max_size=3)))
@example({"scenario": "a\nb: c\n", "0": "0", "z": "true", "~": "~", "x": '"\\', "y": "é\x85"})
def test_what_is_written_reads_back(tree):
    """Text is never parsed as a number, a boolean or a structure."""
    assert yaml.safe_load(dump(tree)) == tree


def test_a_profile_of_the_graph_keeps_all_its_policies():
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        lifespan=Duration(seconds=2, nanoseconds=5),
        avoid_ros_namespace_conventions=True,
    )
    plain, parsed = parse_qos(dump([OFFERED, offered_qos(profile)]))
    assert (plain.reliability.name, plain.durability.name) == ("RELIABLE", "VOLATILE")
    assert (parsed.history.name, parsed.depth) == ("KEEP_LAST", 7)
    assert (parsed.reliability.name, parsed.durability.name) == ("BEST_EFFORT", "TRANSIENT_LOCAL")
    assert (parsed.lifespan.sec, parsed.lifespan.nsec) == (2, 5)
    assert parsed.avoid_ros_namespace_conventions and parsed.liveliness.name == "SYSTEM_DEFAULT"
