# SPDX-License-Identifier: Apache-2.0
"""One MCAP file of a bag, whole after every call or cut back to where it was."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from tactile_hand_ros.bag.metadata import NO_START, FileMetadata
from tactile_hand_ros.bag.stream import ChunkStream

CHUNK_SIZE = 2**20  # bytes; a killed recorder loses less than one chunk
LIBRARY = "tactile_hand_ros"
COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


@dataclass
class Span:
    """Number of messages and the interval of their log times in ns."""

    count: int = 0
    start: int = NO_START
    end: int = 0

    def add(self, log_time: int) -> None:
        """Count a message."""
        self.count += 1
        self.start = min(self.start, log_time)
        self.end = max(self.end, log_time)


class BagFile:
    """Writes records; a call that fails leaves the records before it and closes the file.

    Attributes:
        path: The file.
        span: Number and times of its messages; after a failure, of those that reached the disk.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "zstd",
        chunk_size: int = CHUNK_SIZE,
        profile: str = "ros2",
        library: str = LIBRARY,
    ) -> None:
        """Create the file, which must not exist.

        Raises:
            OSError: If it cannot be created or written.
        """
        self.path = path
        self.span = Span()
        self._stream = ChunkStream(path)
        self._whole = 0
        self._written = Span()
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._writer = Writer(
            self._stream,  # type: ignore[arg-type]
            chunk_size=chunk_size,
            compression=COMPRESSIONS[compression],
        )
        self._do(self._writer.start, profile, library)

    @property
    def size(self) -> int:
        """Number of bytes on the disk."""
        return self._stream.tell()

    @property
    def metadata(self) -> FileMetadata:
        """What the bag's metadata says about the file."""
        span = self.span
        length = max(0, span.end - span.start)
        return FileMetadata(self.path.name, span.start, length, span.count)

    def add_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Add a schema if it is new; return its number."""
        key = name, encoding, text
        if key not in self._schemas:
            self._schemas[key] = int(self._fill(self._writer.register_schema, *key))
        return self._schemas[key]

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a channel and return its number; they count from 1."""
        register = self._writer.register_channel
        return int(self._fill(register, topic, encoding, schema, dict(metadata)))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._do(self._writer.add_metadata, name, dict(values))

    def add_attachment(self, a: Attachment) -> None:
        """Add an attachment."""
        self._do(
            self._writer.add_attachment, a.create_time, a.log_time, a.name, a.media_type, a.data
        )

    def write(
        self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int = 0
    ) -> None:
        """Append a message; times in ns."""
        self.span.add(log_time)
        self._fill(self._writer.add_message, channel, log_time, data, publish_time, sequence)

    def flush(self) -> None:
        """Finish the chunk in progress."""
        self._fill(self._writer.flush)

    def finish(self) -> None:
        """Write the index and close the file."""
        self._fill(self._writer.finish)
        self._stream.close()

    def abandon(self) -> None:
        """Cut the file back to its last whole record and close it."""
        self._stream.abandon(self._whole)
        self.span = self._written

    def _fill(self, call: Callable[..., Any], *args: Any) -> Any:
        """Call what adds to the chunk in progress, and note when it has been written."""
        before = self._whole
        result = self._do(call, *args)
        if self._whole > before:
            self._written = replace(self.span)
        return result

    def _do(self, call: Callable[..., Any], *args: Any) -> Any:
        try:
            result = call(*args)
        except OSError:
            self.abandon()
            raise
        self._whole = self._stream.tell()
        return result
