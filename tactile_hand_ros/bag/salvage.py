# SPDX-License-Identifier: Apache-2.0
"""All records that can still be read from an MCAP file that was cut off or damaged.

The file is walked from the front, record by record, without its index. Of a chunk that was cut off
in the middle everything that decompresses is used. A chunk whose checksum is wrong is left out:
which of its bytes are wrong cannot be known. No size that a file announces is trusted: records and
chunks of more than `LARGEST` bytes are left out, so that memory stays bounded.

Source: MCAP specification, section "Records".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema

from tactile_hand_ros.bag.decompression import LARGEST, unpack
from tactile_hand_ros.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_FOOTER = struct.Struct("<BQQQI8s")  # start of the index, of its index, checksum; and the magic
_UNCHECKED = 12  # bytes of the footer behind those that its checksum covers
_COMPRESSIONS = ("", "zstd", "lz4")
_PIECE = 2**20  # bytes that are read at a time where they are not kept


@dataclass
class Tally:
    """What became of the bytes of a file.

    Attributes:
        messages: Number of messages that were read.
        left: Bytes that could not be used; of chunks, after decompression.
        complete: Whether the file has its end, so that it was not cut off.
        compression: That of the first chunk, empty for none.
        by_topic: Number of messages of each topic.
        oversized: Where the first record or chunk is that is too large, and how large; empty if
            there is none.
    """

    messages: int = 0
    left: int = 0
    complete: bool = False
    compression: str = ""
    by_topic: dict[str, int] = field(default_factory=dict)
    oversized: str = ""

    @property
    def intact(self) -> bool:
        """Whether nothing is missing."""
        return self.complete and not self.left


class _Frame(NamedTuple):
    """A record before it is parsed; `length` is the announced one, `body` may be shorter.

    `start` is where it begins in the file or in the data of a chunk.
    """

    opcode: int
    length: int
    body: bytes
    start: int


_PARSERS: dict[int, Callable[[ReadDataStream, int], McapRecord]] = {
    Opcode.HEADER: lambda stream, _: Header.read(stream),
    Opcode.SCHEMA: lambda stream, _: Schema.read(stream),
    Opcode.CHANNEL: lambda stream, _: Channel.read(stream),
    Opcode.MESSAGE: Message.read,
    Opcode.METADATA: lambda stream, _: Metadata.read(stream),
    Opcode.ATTACHMENT: lambda stream, _: Attachment.read(stream),
}
_ENDS = (Opcode.DATA_END, Opcode.FOOTER)


def salvage(path: Path, tally: Tally) -> Iterator[McapRecord]:
    """Yield header, schemas, channels, messages, metadata and attachments of a file.

    A message comes only after its channel, and a channel after its schema.

    Args:
        path: The file.
        tally: Counts what is read and what is left.

    Raises:
        BagError: If it is not an MCAP file or cannot be read.
    """
    try:
        with path.open("rb") as file:
            yield from _Salvage(tally).read(file, path)
    except OSError as error:
        raise BagError(
            f"The file {path} cannot be read: {error.strerror or error}; check disk and mode."
        ) from None


class _Salvage:
    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._schemas: set[int] = {0}  # 0 stands for no schema
        self._channels: dict[int, str] = {}
        self._compression: str | None = None

    def read(self, file: BinaryIO, path: Path) -> Iterator[McapRecord]:
        size = path.stat().st_size
        magic = file.read(len(MAGIC))
        if not MAGIC.startswith(magic):
            raise BagError(
                f"The file {path} is not an MCAP file: it begins with {magic.hex()}, expected "
                f"{MAGIC.hex()}; only MCAP bags can be recovered."
            )
        while (at := file.tell()) < size:
            frame = _next(file, size)
            if frame is None:
                self._tally.left += size - at
                return
            if frame.opcode in _ENDS:  # what follows is the index
                self._tally.complete = _has_index(file, size)
                return
            if frame.opcode == Opcode.CHUNK:
                yield from self._chunk(frame)
            elif len(frame.body) < frame.length:
                self._tally.left += file.tell() - at
                if frame.length > LARGEST:
                    self._refuse("record", at, frame.length)
            else:
                yield from self._record(frame)

    def _chunk(self, frame: _Frame) -> Iterator[McapRecord]:
        """Read the records of a chunk, or of its front where it was cut off."""
        try:
            _, _, size, checksum, length = _CHUNK.unpack_from(frame.body)
            at = _CHUNK.size
            compression = frame.body[at : at + length].decode()
            packed = frame.body[at + length + 8 :]
        except (struct.error, UnicodeDecodeError):
            self._tally.left += len(frame.body)
            return
        if self._compression is None and compression in _COMPRESSIONS:
            self._compression = self._tally.compression = compression
        cut = len(frame.body) < frame.length
        expected, is_too_large = size, size > LARGEST
        if is_too_large:
            self._refuse("chunk", frame.start, size)
            expected = len(packed)
        data = b"" if is_too_large and not cut else unpack(packed, compression, min(size, LARGEST))
        if not cut and (len(data) != size or (checksum and zlib.crc32(data) != checksum)):
            self._tally.left += expected
            return
        used = 0
        for inner, end in _frames(data):
            used = end
            yield from self._record(inner)
        self._tally.left += max(0, expected - used)

    def _refuse(self, what: str, at: int, size: int) -> None:
        """Note something that is too large to be read."""
        self._tally.oversized = self._tally.oversized or (
            f"the {what} at byte {at} announces {size} bytes, at most {LARGEST} are read"
        )

    def _record(self, frame: _Frame) -> Iterator[McapRecord]:
        parser = _PARSERS.get(frame.opcode)
        if parser is None:
            return
        try:
            record = parser(ReadDataStream(BytesIO(frame.body)), frame.length)
        except Exception:  # damaged data can fail anywhere in the parsers
            self._tally.left += frame.length
            return
        if self._known(record):
            yield record
        else:
            self._tally.left += frame.length

    def _known(self, record: McapRecord) -> bool:
        """Note what a record defines; return whether all it refers to is there."""
        if isinstance(record, Schema):
            self._schemas.add(record.id)
        elif isinstance(record, Channel):
            if record.schema_id not in self._schemas:
                return False
            self._channels[record.id] = record.topic
        elif isinstance(record, Message):
            topic = self._channels.get(record.channel_id)
            if topic is None:
                return False
            self._tally.messages += 1
            self._tally.by_topic[topic] = self._tally.by_topic.get(topic, 0) + 1
        return True


def _has_index(file: BinaryIO, size: int) -> bool:
    """Return whether a file ends as it should, with the index that its footer knows."""
    if size < _FOOTER.size:
        return False
    file.seek(size - _FOOTER.size)
    opcode, _, start, _, checksum, magic = _FOOTER.unpack(file.read())
    if opcode != Opcode.FOOTER or magic != MAGIC or start > size:
        return False
    return not (start and checksum) or _checksum(file, start, size - _UNCHECKED) == checksum


def _checksum(file: BinaryIO, start: int, end: int) -> int:
    """Return the CRC of a part of a file."""
    file.seek(start)
    checksum = 0
    while piece := file.read(max(0, min(end - file.tell(), _PIECE))):
        checksum = zlib.crc32(piece, checksum)
    return checksum


def _next(file: BinaryIO, size: int) -> _Frame | None:
    """Read the next record as far as it goes, or pass over what is too large; None at the end."""
    start = file.tell()
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    if opcode == 0:  # no record: a disk that lost power leaves zeros
        return None
    if length > LARGEST and opcode != Opcode.CHUNK:
        file.seek(min(size, file.tell() + length))
        return _Frame(opcode, length, b"", start)
    body = file.read(min(length, size - file.tell(), LARGEST))
    file.seek(min(size, start + _HEAD.size + length))
    return _Frame(opcode, length, body, start)


def _frames(data: bytes) -> Iterator[tuple[_Frame, int]]:
    """Yield the whole records in the data of a chunk, and where each ends."""
    at = 0
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        start, at = at + _HEAD.size, at + _HEAD.size + length
        if at > len(data) or opcode == 0:
            return
        yield _Frame(opcode, length, data[start:at], start - _HEAD.size), at
