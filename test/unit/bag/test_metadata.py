# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml is rosbag2's version 9, in its order and layout."""

from __future__ import annotations

from tactile_hand_ros.bag.metadata import BagMetadata, FileMetadata, TopicMetadata
from tactile_hand_ros.bag.qos import OfferedQos

# What rosbag2 writes when it opens a file, as `mcap list metadata` shows it.
AT_OPEN = """\
version: 9
storage_identifier: mcap
duration:
  nanoseconds: 0
starting_time:
  nanoseconds_since_epoch: 9223372036854775807
message_count: 0
topics_with_message_count:
  []
compression_format: ""
compression_mode: ""
relative_file_paths:
  - run_0.mcap
files:
  - path: run_0.mcap
    starting_time:
      nanoseconds_since_epoch: 9223372036854775807
    duration:
      nanoseconds: 0
    message_count: 0
custom_data: ~
ros_distro: jazzy"""

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
    - run_1.mcap
  files:
    - path: run_0.mcap
      starting_time:
        nanoseconds_since_epoch: 1000
      duration:
        nanoseconds: 10
      message_count: 2
    - path: run_1.mcap
      starting_time:
        nanoseconds_since_epoch: 1015
      duration:
        nanoseconds: 10
      message_count: 3
  custom_data:
    scenario: "paper 1"
  ros_distro: jazzy"""


def test_record_of_a_bag_without_messages() -> None:
    """The record has no outer key and no messages yet."""
    metadata = BagMetadata(files=[FileMetadata("run_0.mcap")])
    assert metadata.record() == {"serialized_metadata": AT_OPEN}


def test_file_of_a_finished_bag() -> None:
    """Totals come from the files; the last file may end before another."""
    metadata = BagMetadata(
        files=[FileMetadata("run_0.mcap", 1000, 10, 2), FileMetadata("run_1.mcap", 1015, 10, 3)],
        topics=[
            TopicMetadata(
                "/left/wrench", "geometry_msgs/msg/WrenchStamped", (OfferedQos(),), "RIHS01_00ff", 5
            )
        ],
        custom_data={"scenario": "paper 1"},
    )
    assert metadata.file_text() == AT_CLOSE
