# SPDX-License-Identifier: Apache-2.0
"""An MCAP file written again: everything that can still be read in it, with an end and an index."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema

from tactile_hand_ros.bag.bag_file import CHUNK_SIZE, LIBRARY, BagFile
from tactile_hand_ros.bag.metadata import (
    RECORD_KEY,
    RECORD_NAME,
    BagMetadata,
    FileMetadata,
    TopicMetadata,
    merge_topics,
)
from tactile_hand_ros.bag.qos import parse_qos
from tactile_hand_ros.bag.salvage import Tally, salvage
from tactile_hand_ros.bag.yaml_text import load
from tactile_hand_ros.errors import BagError


@dataclass(frozen=True)
class RewrittenFile:
    """A file that was written again, and what it says about the bag.

    Attributes:
        tally: What could be read, and what was left.
        file: The new file.
        topics: Its topics.
        told: What its own metadata says that messages do not.
    """

    tally: Tally
    file: FileMetadata
    topics: list[TopicMetadata]
    told: dict[str, Any] = field(default_factory=dict)


def rewrite(source: Path, target: Path) -> RewrittenFile:
    """Write everything that can be read from a file to a new one.

    Raises:
        BagError: If it holds compressed messages, or the new file cannot be written.
    """
    with contextlib.closing(_Rewriter(source, target)) as rewriter:
        return rewriter.run()


class _Rewriter:
    """Copies records, with the numbers of schemas and channels that the new file gives."""

    def __init__(self, source: Path, target: Path) -> None:
        self._source, self._target = source, target
        self._tally = Tally()
        self._schemas: dict[int, int] = {0: 0}
        self._types: dict[int, str] = {0: ""}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._told: dict[str, Any] = {}
        self._file: BagFile | None = None

    def run(self) -> RewrittenFile:
        try:
            self._file = self._open()
            for record in salvage(self._source, self._tally):
                self._put(self._file, record)
            topics = self._metadata_of_topics()
            bag = bag_metadata([self._file.metadata], topics, [self._told])
            self._file.flush()
            self._file.add_metadata(RECORD_NAME, bag.record())
            self._file.finish()
        except OSError as error:
            raise BagError(
                f"{self._target} cannot be written: {error.strerror or error}; free some space or "
                "choose another folder with --out."
            ) from error
        return RewrittenFile(self._tally, self._file.metadata, topics, self._told)

    def close(self) -> None:
        """Close the file if it is still open after a failure."""
        if self._file is not None:
            self._file.abandon()

    def _open(self) -> BagFile:
        """Create the file, compressed as the broken one."""
        tally, header = Tally(), Header(profile="ros2", library=LIBRARY)
        for record in salvage(self._source, tally):
            if isinstance(record, Header):
                header = record
            if isinstance(record, Message):
                break
        compression = tally.compression or ("none" if tally.messages else "zstd")
        return BagFile(self._target, compression, CHUNK_SIZE, header.profile, LIBRARY)

    def _put(self, file: BagFile, record: McapRecord) -> None:
        if isinstance(record, Message):
            file.write(
                self._channels[record.channel_id],
                record.data,
                record.log_time,
                record.publish_time,
                record.sequence,
            )
            self._counts[record.channel_id] += 1
        elif isinstance(record, Schema):
            number = file.add_schema(record.name, record.encoding, record.data)
            self._schemas[record.id], self._types[record.id] = number, record.name
        elif isinstance(record, Channel):
            self._put_channel(file, record)
        elif isinstance(record, Metadata):
            file.add_metadata(record.name, record.metadata)
            if record.name == RECORD_NAME:
                told = _tree(record.metadata)
                refuse_compressed(self._source, told)
                self._told.update(_told(told))
        elif isinstance(record, Attachment):
            file.add_attachment(record)

    def _put_channel(self, file: BagFile, record: Channel) -> None:
        if record.id in self._channels:
            return
        schema = self._schemas[record.schema_id]
        number = file.add_channel(record.topic, record.message_encoding, schema, record.metadata)
        self._channels[record.id], self._topics[record.id] = number, record
        self._counts[record.id] = 0

    def _metadata_of_topics(self) -> list[TopicMetadata]:
        return [
            TopicMetadata(
                name=channel.topic,
                type=self._types[channel.schema_id],
                offered_qos_profiles=parse_qos(channel.metadata.get("offered_qos_profiles", "")),
                type_description_hash=channel.metadata.get("topic_type_hash", ""),
                message_count=self._counts[number],
                serialization_format=channel.message_encoding,
            )
            for number, channel in self._topics.items()
        ]


def _tree(record: Mapping[str, str]) -> dict[str, Any]:
    """Return the writer's own metadata, nothing if it makes no sense."""
    try:
        return dict(load(record[RECORD_KEY]))
    except (yaml.YAMLError, KeyError, TypeError, ValueError):
        return {}


def _told(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return what metadata says that messages do not."""
    custom, distro = tree.get("custom_data"), tree.get("ros_distro")
    told: dict[str, Any] = {"ros_distro": str(distro)} if distro else {}
    if isinstance(custom, Mapping):
        told["custom_data"] = {str(key): str(value) for key, value in custom.items()}
    return told


def bag_metadata(
    files: Sequence[FileMetadata],
    topics: Iterable[TopicMetadata],
    told: Iterable[Mapping[str, Any]],
    more: Mapping[str, str] | None = None,
) -> BagMetadata:
    """Return what a bag says of itself.

    Args:
        files: Its files.
        topics: Topics of each file; those of one name become one.
        told: What earlier metadata said that messages do not say, later ones last.
        more: What else to say.
    """
    custom: dict[str, str] = {}
    distro = os.environ.get("ROS_DISTRO") or "jazzy"
    for tree in told:
        custom |= tree.get("custom_data", {})
        distro = tree.get("ros_distro", distro)
    return BagMetadata(files, merge_topics(topics), custom | dict(more or {}), distro)


def refuse_compressed(bag: Path, told: Mapping[str, Any]) -> None:
    """Refuse messages that are compressed one by one; compressed files are known by their names.

    Raises:
        BagError: If they are.
    """
    if told.get("compression_format") and str(told.get("compression_mode")).upper() != "FILE":
        raise compressed(bag)


def compressed(bag: Path) -> BagError:
    """Return the error for a bag that rosbag2 has compressed as a whole or by messages."""
    return BagError(
        f"The bag {bag} has files or messages compressed by rosbag2, expected plain or chunk "
        "compressed MCAP; decompress it with `ros2 bag convert` first."
    )
