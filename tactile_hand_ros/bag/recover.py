# SPDX-License-Identifier: Apache-2.0
"""Recovery of truncated bags: every complete chunk, or the last seconds, in a new bag."""

from __future__ import annotations

import contextlib
import os
import shutil
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import yaml
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from tactile_hand_ros.bag.metadata import RECORD_KEY, RECORD_NAME, BagMetadata, OfferedQos
from tactile_hand_ros.bag.reader import find_bag
from tactile_hand_ros.bag.schema import MessageDefinition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.names import ACCEPTED_POSE

LARGEST = 2**28
"""Maximum size of a record or chunk [B]; a larger announced size means damage."""

_LATCHED = ("transient_local", 1)  # by name, or by rosbag2's older number
_MAGIC = b"\x89MCAP0\r\n"
_EVER = 1e10  # s, longer than since the epoch


class Recovery(NamedTuple):
    """The result of a recovery.

    Attributes:
        target: The new bag.
        metadata: Its file and topics.
        left: Number of truncated or damaged bytes.
    """

    target: Path
    metadata: BagMetadata
    left: int


def recover(bag: Path | str, out: Path | str | None = None, last: float = 0.0) -> Recovery:
    """Write all complete chunks of a bag, from any recorder, to a new bag.

    Args:
        bag: Bag folder, folder of a run with ``bag/`` in it, or ``.mcap`` file.
        out: Folder to create; by default next to the bag, with the suffix ``_recovered``.
        last: Keep the messages received in the last seconds only, and those of latched topics; 0
            keeps all.

    Raises:
        BagError: If no MCAP bag is found, no message can be recovered, the output exists, or
            writing fails.
    """
    source = find_bag(Path(bag))
    files = _files_of(source)
    plain = (source if source.is_dir() else source.with_suffix("")).resolve()
    target = Path(out) if out is not None else plain.with_name(plain.name + "_recovered")
    since = _last_received(files) - round(1e9 * last) if 0.0 < last < _EVER else 0
    copy = _Copy(BagWriter(target, compression="zstd"), since)
    try:
        for file in files:
            copy.add(file)
        recovery = Recovery(target, copy.close(), copy.left)
        if not recovery.metadata.message_count:
            raise BagError(f"nothing in {source} can be recovered; no bag was written.")
        return recovery
    except BaseException:  # half a bag would block the next attempt
        shutil.rmtree(target, ignore_errors=True)
        raise


def _files_of(bag: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers."""
    found = [bag] if bag.is_file() else bag.glob("*.mcap")
    files = sorted(found, key=lambda file: (len(file.name), file.name))
    if not files:
        raise BagError(
            f"The folder {bag} contains no .mcap file. Only MCAP bags can be recovered; run `ros2 "
            "bag convert` first if rosbag2 compressed the files."
        )
    return files


def _index(stream: BinaryIO) -> Summary:
    """Return the index at the end of a file, which is empty if the file is cut off."""
    with contextlib.suppress(Exception):  # damaged data can fail anywhere in the parsers
        stream.seek(0)  # it reads the magic number from where it is
        return SeekingReader(stream, record_size_limit=LARGEST).get_summary() or Summary()
    return Summary()


def _records(stream: BinaryIO, index: Summary) -> Iterator[McapRecord | int]:
    """Yield the records of a file up to its index, and the size of each damaged part, bytes.

    A record that runs over the start of a chunk, or ends the data before one, is damaged. So is a
    message between chunks: it was an index.
    """
    size, begin, is_chunked = stream.seek(0, os.SEEK_END), len(_MAGIC), False
    starts = (at.chunk_start_offset for at in index.chunk_indexes)
    chunks = sorted(start for start in starts if start < size)
    while begin < size:
        end = stream.seek(begin)
        reader = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=LARGEST)
        with contextlib.suppress(Exception):  # damaged data can fail anywhere in the parsers
            for record in reader.records:
                before, after = bisect_right(chunks, end), bisect_left(chunks, stream.tell())
                if isinstance(record, DataEnd) and after == len(chunks):
                    return
                if isinstance(record, DataEnd) or after > before:
                    break
                start, end = end, stream.tell()
                is_chunked = is_chunked or isinstance(record, Chunk)
                yield end - start if is_chunked and isinstance(record, Message) else record
        begin = next((at for at in chunks if at > end), size)
        if begin > end:
            yield begin - end


def _last_received(files: list[Path]) -> int:
    """Return when the last complete chunk or message of a bag was received, ns; 0 without one."""
    found = 0
    for file in files:
        with file.open("rb") as stream:
            for record in _records(stream, _index(stream)):
                if isinstance(record, Chunk):
                    found = max(found, record.message_end_time)
                elif isinstance(record, Message):
                    found = max(found, record.log_time)
    return found


class _Copy:
    """Copies the readable parts of MCAP files to a new bag."""

    def __init__(self, writer: BagWriter, since: int) -> None:
        self.left = 0
        self._since = since
        self._latched: set[int] = set()
        self._writer = writer
        self._numbers: dict[tuple[str, str], int] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}
        self._index = Summary()  # of a file, empty if it is cut off

    def add(self, file: Path) -> None:
        """Add all messages and metadata of a file, up to its index or its truncated end."""
        self._schemas, self._channels = {}, {}
        with file.open("rb") as stream:
            if not _MAGIC.startswith(stream.read(len(_MAGIC))):
                raise BagError(f"The file {file} is not an MCAP file; only those can be recovered.")
            self._index = _index(stream)
            for record in _records(stream, self._index):
                if isinstance(record, int):
                    self.left += record
                else:
                    self._add_record(record)

    def _add_record(self, record: McapRecord) -> None:
        """Add a record, or count its bytes if it is damaged."""
        try:
            if isinstance(record, Chunk):
                if record.uncompressed_size > LARGEST:
                    raise ValueError(f"a chunk announces {record.uncompressed_size} bytes")
                for each in breakup_chunk(record, validate_crc=True):
                    self._add_record(each)
            elif isinstance(record, Message):
                if record.channel_id not in self._channels:  # they were in a damaged chunk
                    self._add_channel(self._index.channels[record.channel_id])
                channel = self._channels[record.channel_id]
                if record.log_time < self._since and channel not in self._latched:
                    return
                self._writer.write(channel, record.data, record.log_time, record.publish_time)
            elif isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._add_channel(record)
            elif isinstance(record, Metadata):
                self._keep(record)
        except BagError:
            raise
        except Exception:
            self.left += len(getattr(record, "data", b""))

    def _add_channel(self, channel: Channel) -> None:
        """Announce a channel; channels of one topic in several files become one."""
        schema = self._schemas.get(channel.schema_id) or self._index.schemas[channel.schema_id]
        key = channel.topic, schema.name
        if key not in self._numbers:
            offers = _offers(channel.metadata.get("offered_qos_profiles", ""))
            self._numbers[key] = self._writer.add_channel(
                *key,
                offers=offers,
                type_hash=channel.metadata.get("topic_type_hash", ""),
                definition=MessageDefinition(schema.encoding, schema.data.decode(errors="replace")),
            )
            is_latched = any(offer["durability"] in _LATCHED for offer in offers)
            if is_latched or channel.topic.endswith(f"/{ACCEPTED_POSE}"):  # it stays in force
                self._latched.add(self._numbers[key])
        self._channels[channel.id] = self._numbers[key]

    def close(self) -> BagMetadata:
        self._writer.custom_data["recovered_bytes_left"] = str(self.left)
        return self._writer.close()

    def _keep(self, record: Metadata) -> None:
        """Copy a metadata record; of rosbag2's own record, copy only the custom data."""
        if record.name == RECORD_NAME:
            tree = yaml.safe_load(record.metadata[RECORD_KEY])
            custom = {str(key): str(text) for key, text in tree["custom_data"].items()}
            self._writer.custom_data |= custom
        else:
            self._writer.add_metadata(record.name, record.metadata)


def _offers(text: str) -> list[OfferedQos]:
    """Parse a channel's offers; older versions of rosbag2 use numbers for the policies."""
    try:
        return [dict(offer) for offer in dump_qos_v9(parse_qos(text))]
    except Exception:  # other recorders may write any text
        return []
