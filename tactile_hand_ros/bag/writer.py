# SPDX-License-Identifier: Apache-2.0
"""Writing of a rosbag2 folder with one MCAP file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer

from tactile_hand_ros.bag.errors import BagError
from tactile_hand_ros.bag.metadata import (
    FILE_NAME,
    NO_START,
    RECORD_NAME,
    BagMetadata,
    FileMetadata,
    TopicMetadata,
)
from tactile_hand_ros.bag.qos import OfferedQos, qos_text
from tactile_hand_ros.bag.schema import MessageDefinition, message_definition
from tactile_hand_ros.bag.stream import ChunkStream

CHUNK_SIZE = 65536  # bytes; a killed recorder loses less than one chunk
LIBRARY = "tactile_hand_ros"
_COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


@dataclass
class _Channel:
    """What the metadata will say about one channel."""

    topic: str
    type_name: str
    offers: tuple[OfferedQos, ...]
    type_hash: str
    count: int = 0

    def metadata(self) -> TopicMetadata:
        return TopicMetadata(
            self.topic, self.type_name, self.offers, self.type_hash, message_count=self.count
        )


@dataclass
class _Span:
    """Number of messages and the interval of their log times in ns."""

    count: int = 0
    start: int = NO_START
    end: int = 0

    def add(self, log_time: int) -> None:
        self.count += 1
        self.start = min(self.start, log_time)
        self.end = max(self.end, log_time)

    def metadata(self, path: str) -> FileMetadata:
        return FileMetadata(path, self.start, max(0, self.end - self.start), self.count)


@dataclass
class BagWriter:
    """Writes serialized messages to a new bag, as rosbag2 (Jazzy) would.

    Every finished chunk is handed to the operating system at once, so that a killed process
    loses the messages since the last chunk or `flush` and nothing else. A failed write (a full
    disk) cuts the file back to its last whole chunk and closes it; what is there can be recovered.

    Attributes:
        folder: Folder to create; the file in it has the same name.
        compression: ``none``, ``lz4`` or ``zstd``, of whole chunks.
        chunk_size: Size at which a chunk is written, in bytes before compression.
        custom_data: Texts for the bag's metadata; may be filled until `close`.
    """

    folder: Path
    compression: str = "none"
    chunk_size: int = CHUNK_SIZE
    custom_data: dict[str, str] = field(default_factory=dict)
    ros_distro: str = field(default_factory=lambda: os.environ.get("ROS_DISTRO") or "jazzy")

    def __post_init__(self) -> None:
        """Create the folder and open the file.

        Raises:
            BagError: If the folder exists, cannot be created, or the compression is unknown.
        """
        self.folder = Path(self.folder)
        if self.compression not in _COMPRESSIONS:
            raise BagError(
                f"Compression is '{self.compression}', expected one of {', '.join(_COMPRESSIONS)}."
            )
        self._channels: list[_Channel] = []
        self._schemas: dict[str, int] = {}
        self._span = _Span()
        self.bytes_received = 0
        self._open()

    def _open(self) -> None:
        _create(self.folder)
        self.path = self.folder / f"{self.folder.resolve().name}_0.mcap"
        try:
            self._stream = ChunkStream(self.path)
            self._writer = Writer(
                self._stream,  # type: ignore[arg-type]
                chunk_size=self.chunk_size,
                compression=_COMPRESSIONS[self.compression],
            )
            self._writer.start(profile="ros2", library=LIBRARY)
            self._writer.add_metadata(RECORD_NAME, self.metadata().record())
        except OSError as error:
            raise self._failure(error) from error
        self._whole = self._stream.tell()

    @property
    def is_open(self) -> bool:
        """Whether messages are accepted."""
        return not self._stream.closed

    @property
    def message_count(self) -> int:
        """Number of messages accepted so far."""
        return self._span.count

    def add_channel(
        self,
        topic: str,
        type_name: str,
        *,
        offers: Iterable[OfferedQos] = (),
        type_hash: str = "",
        definition: MessageDefinition | None = None,
    ) -> int:
        """Announce a topic.

        Args:
            topic: Full name.
            type_name: Full name of the type, e.g. ``std_msgs/msg/String``.
            offers: What its publishers offer.
            type_hash: Hash of the type, ``RIHS01_...``.
            definition: Schema; that of the installed package if None.

        Returns:
            Number of the channel for `write`.

        Raises:
            BagError: If the bag is closed or the type's definition is not installed.
        """
        self._check_open()
        channel = _Channel(topic, type_name, tuple(offers), type_hash)
        metadata = {"offered_qos_profiles": qos_text(channel.offers), "topic_type_hash": type_hash}
        schema = self._schema(type_name, definition)
        self._channels.append(channel)
        return int(self._guard(self._writer.register_channel, topic, "cdr", schema, metadata))

    def _schema(self, type_name: str, definition: MessageDefinition | None) -> int:
        if type_name not in self._schemas:
            used = definition or message_definition(type_name)
            self._schemas[type_name] = self._guard(
                self._writer.register_schema, type_name, used.encoding, used.text.encode()
            )
        return self._schemas[type_name]

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to the MCAP file, which any MCAP reader shows.

        Args:
            name: Name of the record.
            values: Its texts by key.

        Raises:
            BagError: If the bag is closed or the disk refuses the data.
        """
        self._check_open()
        self._guard(self._writer.add_metadata, name, dict(values))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int) -> None:
        """Append one serialized message.

        Args:
            channel: Number from `add_channel`.
            data: CDR bytes.
            log_time: Time of reception in ns since the epoch.
            publish_time: Time of publication in ns since the epoch.

        Raises:
            BagError: If the bag is closed or the disk refuses the data.
        """
        self._check_open()
        try:
            self._writer.add_message(channel, log_time, data, publish_time)
        except OSError as error:
            raise self._failure(error) from error
        self._whole = self._stream.tell()
        self._channels[channel - 1].count += 1
        self._span.add(log_time)
        self.bytes_received += len(data)

    def flush(self) -> None:
        """Finish the chunk in progress, so that its messages survive the death of the process.

        Raises:
            BagError: If the disk refuses the data.
        """
        if self.is_open:
            self._guard(self._writer.flush)

    def close(self) -> BagMetadata:
        """Write index and metadata; repeated calls change nothing.

        Returns:
            The metadata that was written.

        Raises:
            BagError: If the disk refuses the data.
        """
        metadata = self.metadata()
        if self.is_open:
            self._guard(self._writer.flush)
            self._guard(self._writer.add_metadata, RECORD_NAME, metadata.record())
            self._guard(self._writer.finish)
            self._stream.close()
            self._write_metadata(metadata.file_text())
        return metadata

    def _write_metadata(self, text: str) -> None:
        """Write ``metadata.yaml`` whole or not at all."""
        draft = self.folder / f".{FILE_NAME}"
        try:
            draft.write_text(text, encoding="utf-8")
            draft.replace(self.folder / FILE_NAME)
        except OSError as error:
            raise self._failure(error) from error

    def metadata(self) -> BagMetadata:
        """Return what is known of the bag now; topics in order of their names."""
        topics = sorted(self._channels, key=lambda channel: channel.topic)
        return BagMetadata(
            files=(self._span.metadata(self.path.name),),
            topics=[channel.metadata() for channel in topics],
            custom_data=self.custom_data,
            ros_distro=self.ros_distro,
        )

    def counts(self) -> Mapping[str, int]:
        """Return the number of messages by topic."""
        return {channel.topic: channel.count for channel in self._channels}

    def _check_open(self) -> None:
        if self._stream.closed:
            raise BagError(f"The bag {self.folder} is closed, nothing can be added to it.")

    def _guard(self, call: Any, *args: Any) -> Any:
        try:
            result = call(*args)
        except OSError as error:
            raise self._failure(error) from error
        self._whole = self._stream.tell()
        return result

    def _failure(self, error: OSError) -> BagError:
        """Cut the file back to its last whole record and close it."""
        self._stream.abandon(self._whole)
        return BagError(
            f"The bag {self.folder} could not be written: {error.strerror or error}; recording "
            f"ended after {self._span.count} messages, free some space and run "
            f"`tactile-hand recover {self.folder}`."
        )

    def __enter__(self) -> BagWriter:
        """Return the open writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, also after an error: what was recorded stays readable."""
        self.close()


def _create(folder: Path) -> None:
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise BagError(
            f"The output {folder} exists already, expected a new folder; choose another name or "
            "remove it."
        ) from None
    except OSError as error:
        raise BagError(
            f"The output {folder} cannot be created: {error.strerror}; choose a folder that can "
            "be written."
        ) from None
