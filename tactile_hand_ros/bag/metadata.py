# SPDX-License-Identifier: Apache-2.0
"""The metadata of a bag, version 9: ``metadata.yaml`` and the record inside the MCAP file.

Source: ``rosbag2_storage`` (Jazzy), ``BagMetadata`` and its YAML conversion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

VERSION = 9
NO_START = 2**63 - 1  # ns, the starting time of a bag without messages
FILE_NAME = "metadata.yaml"
RECORD_NAME = "rosbag2"
RECORD_KEY = "serialized_metadata"

OfferedQos = Mapping[str, Any]
"""The QoS profile that one publisher offers, nested as in the metadata."""


_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.+-]*")


@dataclass
class TopicMetadata:
    """One recorded topic."""

    name: str
    type: str
    offers: Sequence[OfferedQos] = ()
    type_hash: str = ""
    message_count: int = 0

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping with the nesting of rosbag2."""
        return {
            "topic_metadata": {
                "name": self.name,
                "type": self.type,
                "serialization_format": "cdr",
                "offered_qos_profiles": [dict(offer) for offer in self.offers],
                "type_description_hash": self.type_hash,
            },
            "message_count": self.message_count,
        }


@dataclass(frozen=True)
class BagMetadata:
    """A bag of one MCAP file.

    Attributes:
        path: Name of the file in the folder.
        start: Log time of the first message [ns since the epoch], `NO_START` without messages.
        duration: Time from the first to the last message [ns].
        topics: The recorded topics.
        custom_data: Texts by name.
    """

    path: str
    start: int = NO_START
    duration: int = 0
    topics: Sequence[TopicMetadata] = ()
    custom_data: Mapping[str, str] = field(default_factory=dict)

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(topic.message_count for topic in self.topics)

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping in the key order of rosbag2."""
        totals = {
            "duration": {"nanoseconds": self.duration},
            "starting_time": {"nanoseconds_since_epoch": self.start},
            "message_count": self.message_count,
        }
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            **totals,
            "topics_with_message_count": [topic.as_tree() for topic in self.topics],
            "compression_format": "",  # these two describe compressed files or messages;
            "compression_mode": "",  # MCAP itself compresses the chunks
            "relative_file_paths": [self.path],
            "files": [{"path": self.path, **totals}],
            "custom_data": dict(self.custom_data),
            "ros_distro": "jazzy",  # whose format it is
        }

    def file_text(self) -> str:
        """Return the content of ``metadata.yaml``."""
        return dump({"rosbag2_bagfile_information": self.as_tree()})

    def record(self) -> dict[str, str]:
        """Return the content of the MCAP metadata record named `RECORD_NAME`."""
        return {RECORD_KEY: dump(self.as_tree())}


def offered_qos(profile: Any) -> OfferedQos:
    """Return an ``rclpy.qos.QoSProfile`` of the graph, nested as in the metadata."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _duration(profile.deadline),
        "lifespan": _duration(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _duration(duration: Any) -> dict[str, int]:
    seconds, rest = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": rest}


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes ambiguous texts and writes repeated objects in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _quoted(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if _PLAIN.fullmatch(text) else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _quoted)


def dump(tree: Any) -> str:
    """Return YAML text that rosbag2 can read, without a trailing newline."""
    text = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=float("inf"), allow_unicode=True)
    return text.strip()
