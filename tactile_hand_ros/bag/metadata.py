# SPDX-License-Identifier: Apache-2.0
"""The metadata of a bag, version 9: ``metadata.yaml`` and the record inside the MCAP file.

Source: ``rosbag2_storage`` (Jazzy), ``BagMetadata`` and its YAML conversion.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tactile_hand_ros.bag.qos import OfferedQos
from tactile_hand_ros.bag.yaml_text import dump

VERSION = 9
NO_START = 2**63 - 1  # ns, the starting time of a bag without messages
FILE_NAME = "metadata.yaml"
RECORD_NAME = "rosbag2"
RECORD_KEY = "serialized_metadata"


@dataclass(frozen=True)
class TopicMetadata:
    """One recorded topic."""

    name: str
    type: str
    offered_qos_profiles: tuple[OfferedQos, ...] = ()
    type_description_hash: str = ""
    message_count: int = 0
    serialization_format: str = "cdr"

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping as rosbag2 nests it."""
        return {
            "topic_metadata": {
                "name": self.name,
                "type": self.type,
                "serialization_format": self.serialization_format,
                "offered_qos_profiles": [qos.as_tree() for qos in self.offered_qos_profiles],
                "type_description_hash": self.type_description_hash,
            },
            "message_count": self.message_count,
        }


@dataclass(frozen=True)
class FileMetadata:
    """One file of the bag; times in ns since the epoch."""

    path: str
    start: int = NO_START
    duration: int = 0
    message_count: int = 0

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping as rosbag2 nests it."""
        return {
            "path": self.path,
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "duration": {"nanoseconds": self.duration},
            "message_count": self.message_count,
        }


@dataclass(frozen=True)
class BagMetadata:
    """A whole bag: its files in order and its topics."""

    files: Sequence[FileMetadata]
    topics: Sequence[TopicMetadata] = ()
    custom_data: Mapping[str, str] = field(default_factory=dict)
    ros_distro: str = "jazzy"
    storage_identifier: str = "mcap"

    @property
    def message_count(self) -> int:
        """Number of messages in all files."""
        return sum(file.message_count for file in self.files)

    @property
    def start(self) -> int:
        """Log time of the first message in ns, `NO_START` without messages."""
        return min((file.start for file in self.files), default=NO_START)

    @property
    def duration(self) -> int:
        """Time from the first to the last message in ns."""
        ends = [file.start + file.duration for file in self.files if file.message_count]
        return max(ends) - self.start if ends else 0

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping in the order in which rosbag2 writes it."""
        return {
            "version": VERSION,
            "storage_identifier": self.storage_identifier,
            "duration": {"nanoseconds": self.duration},
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "message_count": self.message_count,
            "topics_with_message_count": [topic.as_tree() for topic in self.topics],
            "compression_format": "",  # these two mean compressed files or messages,
            "compression_mode": "",  # chunk compression is the MCAP file's own affair
            "relative_file_paths": [file.path for file in self.files],
            "files": [file.as_tree() for file in self.files],
            "custom_data": dict(self.custom_data),
            "ros_distro": self.ros_distro,
        }

    def file_text(self) -> str:
        """Return the content of ``metadata.yaml``."""
        return dump({"rosbag2_bagfile_information": self.as_tree()})

    def record(self) -> dict[str, str]:
        """Return the content of the MCAP metadata record named `RECORD_NAME`."""
        return {RECORD_KEY: dump(self.as_tree())}


def merge_topics(topics: Iterable[TopicMetadata]) -> list[TopicMetadata]:
    """Return topics in order of their names, those of one name with the sum of their messages."""
    found: dict[str, TopicMetadata] = {}
    for topic in topics:
        if (before := found.get(topic.name)) is not None:
            topic = replace(before, message_count=before.message_count + topic.message_count)
        found[topic.name] = topic
    return [found[name] for name in sorted(found)]
