# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags that were cut off: every whole chunk, written to a new bag."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Chunk, DataEnd, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from tactile_hand_ros.bag.metadata import (
    FILE_NAME,
    RECORD_KEY,
    RECORD_NAME,
    BagMetadata,
    OfferedQos,
)
from tactile_hand_ros.bag.reader import check_regular, read_raw, summarize
from tactile_hand_ros.bag.schema import MessageDefinition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError, counted

LARGEST = 2**28
"""Largest record or chunk that is taken into memory [B]; what announces more is damaged."""

_COMPRESSED = (".zstd", ".lz4")  # what rosbag2 adds to the names of compressed files
_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class RecoveredBag:
    """The result of a recovery.

    Attributes:
        source: The broken bag.
        target: The new one.
        metadata: File and topics of the new bag.
        left: Bytes that were cut off or damaged.
    """

    source: Path
    target: Path
    metadata: BagMetadata
    left: int

    @property
    def messages(self) -> int:
        """Number of messages that were recovered."""
        return self.metadata.message_count

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        topics = sum(1 for topic in self.metadata.topics if topic.message_count)
        lost = f"{counted(self.left, 'byte')} could not be used" if self.left else "nothing is lost"
        return (
            f"recovered {counted(self.messages, 'message')} on {counted(topics, 'topic')} to "
            f"{self.target}; {lost}; {self.source} was not touched"
        )


def recover(bag: Path | str, out: Path | str | None = None) -> RecoveredBag:
    """Write all whole chunks of a bag, of any recorder, to a new bag.

    Args:
        bag: Bag folder, folder of a run with ``bag/`` in it, or ``.mcap`` file.
        out: Folder to create; by default beside the bag, with ``_recovered`` after its name.

    Raises:
        BagError: If there is no MCAP bag, the output exists, or the disk refuses the data.
    """
    source = find_bag(Path(bag))
    files = _files_of(source)
    plain = (source if source.is_dir() else source.with_suffix("")).resolve()
    target = Path(out) if out is not None else plain.with_name(plain.name + "_recovered")
    copy = _Copy(BagWriter(target, compression="zstd"))
    try:
        for file in files:
            copy.add(file)
        return RecoveredBag(source, target, copy.close(), copy.left)
    except BaseException:  # half a bag would only be in the way of the next attempt
        shutil.rmtree(target, ignore_errors=True)
        raise


def is_whole(bag: Path) -> bool:
    """Return whether nothing is missing in a bag; all of it is read."""
    try:
        return sum(1 for _ in read_raw(bag)) == summarize(bag).message_count
    except BagError:
        return False


def find_bag(path: Path) -> Path:
    """Return the bag that a path means: itself, or ``bag/`` in the folder of a run.

    Raises:
        BagError: If it does not exist.
    """
    if not path.exists():
        raise BagError(f"The bag {path} does not exist; check the path.")
    return path / "bag" if (path / "bag").is_dir() else path


def _files_of(bag: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers."""
    found = [bag] if bag.is_file() else bag.glob("*.mcap*")
    files = sorted(found, key=lambda file: (len(file.name), file.name))
    if not files:
        raise BagError(f"The folder {bag} holds no .mcap file; only MCAP bags can be recovered.")
    for file in files:
        check_regular(file)
    if any(file.suffix in _COMPRESSED for file in files) or _has_compressed_messages(bag):
        raise BagError(
            f"The bag {bag} has files or messages compressed by rosbag2, expected plain or chunk "
            "compressed MCAP; decompress it with `ros2 bag convert` first."
        )
    return [file for file in files if file.suffix == ".mcap" or file == bag]


def _has_compressed_messages(bag: Path) -> bool:
    """Return whether rosbag2 has compressed messages one by one; only ``metadata.yaml`` says so."""
    file = bag / FILE_NAME
    text = file.read_bytes() if bag.is_dir() and file.is_file() else b""
    return re.search(rb"compression_mode: \W?message", text, re.IGNORECASE) is not None


class _Copy:
    """Writes what can be read from MCAP files to a new bag."""

    def __init__(self, writer: BagWriter) -> None:
        self.left = 0
        self._writer = writer
        self._numbers: dict[tuple[str, str], int] = {}

    def add(self, file: Path) -> None:
        """Add all messages and metadata of a file; a message comes after its channel."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, int] = {}
        for record in self._records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                channels[record.id] = self._channel(record, schemas[record.schema_id])
            elif isinstance(record, Message) and record.channel_id in channels:
                number = channels[record.channel_id]
                self._writer.write(number, record.data, record.log_time, record.publish_time)
            elif isinstance(record, Message):
                self.left += len(record.data)
            elif isinstance(record, Metadata):
                self._keep(record)

    def close(self) -> BagMetadata:
        """Finish the new bag."""
        self._writer.custom_data["recovered_bytes_left"] = str(self.left)
        return self._writer.close()

    def _channel(self, channel: Channel, schema: Schema) -> int:
        """Return the number of a channel in the new bag; those of several files become one."""
        key = channel.topic, schema.name
        if key not in self._numbers:
            self._numbers[key] = self._writer.add_channel(
                *key,
                offers=_offers(channel.metadata.get("offered_qos_profiles", "")),
                type_hash=channel.metadata.get("topic_type_hash", ""),
                definition=MessageDefinition(schema.encoding, schema.data.decode(errors="replace")),
            )
        return self._numbers[key]

    def _keep(self, record: Metadata) -> None:
        """Copy a metadata record; of rosbag2's own, what messages do not tell."""
        if record.name != RECORD_NAME:
            self._writer.add_metadata(record.name, record.metadata)
            return
        tree = _mapping(record.metadata.get(RECORD_KEY, ""))
        custom = tree.get("custom_data")
        if isinstance(custom, dict):
            self._writer.custom_data |= {str(key): str(text) for key, text in custom.items()}
        self._writer.ros_distro = str(tree.get("ros_distro") or self._writer.ros_distro)

    def _records(self, path: Path) -> Iterator[McapRecord]:
        """Yield the records of a file and of its whole chunks, up to the index or the cut."""
        with path.open("rb") as file:
            if not _MAGIC.startswith(file.read(len(_MAGIC))):
                raise BagError(f"The file {path} is not an MCAP file; only those can be recovered.")
            end = file.tell()
            file.seek(0)
            records = StreamReader(file, emit_chunks=True, record_size_limit=LARGEST).records
            while (record := self._next(records)) is not None:
                end = file.tell()
                if isinstance(record, DataEnd | Footer):
                    return
                yield from self._unpacked(record) if isinstance(record, Chunk) else [record]
            self.left += path.stat().st_size - end

    def _next(self, records: Iterator[McapRecord]) -> McapRecord | None:
        try:
            return next(records, None)
        except Exception:  # damaged data can fail anywhere in the parsers
            return None

    def _unpacked(self, chunk: Chunk) -> list[McapRecord]:
        """Return the records of a chunk, none if it is damaged."""
        try:
            if chunk.uncompressed_size <= LARGEST:
                return breakup_chunk(chunk, validate_crc=True)
        except Exception:  # as above
            pass
        self.left += len(chunk.data)
        return []


def _offers(text: str) -> list[OfferedQos]:
    """Read a channel's offers, in which older versions of rosbag2 number the policies."""
    try:
        return [dict(offer) for offer in dump_qos_v9(parse_qos(text))]
    except Exception:  # text of others, which may be anything
        return []


def _mapping(text: str) -> dict[Any, Any]:
    try:
        tree = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}
    return tree if isinstance(tree, dict) else {}
