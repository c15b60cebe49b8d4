# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml follows version 9 of rosbag2."""

import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2.metadata import parse_qos

from tactile_hand_ros.bag.metadata import BagMetadata, TopicMetadata, dump, offered_qos

# Written by rosbag2, as shown by `mcap list metadata`.
AT_CLOSE = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 25
  starting_time:
    nanoseconds_since_epoch: 1000
  message_count: 5
  topics_with_message_count:
    - topic_metadata:
        name: /left/wrench
        type: geometry_msgs/msg/WrenchStamped
        serialization_format: cdr
        offered_qos_profiles:
          - history: unknown
            depth: 0
            reliability: reliable
            durability: volatile
            deadline:
              sec: 9223372036
              nsec: 854775807
            lifespan:
              sec: 9223372036
              nsec: 854775807
            liveliness: automatic
            liveliness_lease_duration:
              sec: 9223372036
              nsec: 854775807
            avoid_ros_namespace_conventions: false
        type_description_hash: RIHS01_00ff
      message_count: 5
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - run_0.mcap
  files:
    - path: run_0.mcap
      duration:
        nanoseconds: 25
      starting_time:
        nanoseconds_since_epoch: 1000
      message_count: 5
  custom_data:
    scenario: "paper 1"
  ros_distro: jazzy"""
INFORMATION = yaml.safe_load(AT_CLOSE)["rosbag2_bagfile_information"]
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
