# SPDX-License-Identifier: Apache-2.0
"""Writing of a rosbag2 folder with one or more MCAP files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_hand_ros.bag.bag_file import CHUNK_SIZE, COMPRESSIONS, BagFile
from tactile_hand_ros.bag.metadata import (
    FILE_NAME,
    RECORD_NAME,
    BagMetadata,
    FileMetadata,
    TopicMetadata,
    merge_topics,
)
from tactile_hand_ros.bag.qos import OfferedQos, qos_text
from tactile_hand_ros.bag.schema import MessageDefinition, message_definition
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.files import replace_text


@dataclass
class _Channel:
    """What schema, channel and metadata say about one topic."""

    topic: str
    type_name: str
    offers: tuple[OfferedQos, ...]
    type_hash: str
    definition: MessageDefinition
    count: int = 0

    def metadata(self) -> TopicMetadata:
        return TopicMetadata(
            self.topic, self.type_name, self.offers, self.type_hash, message_count=self.count
        )


@dataclass
class BagWriter:
    """Writes serialized messages to a new bag, as rosbag2 (Jazzy) would.

    Every finished chunk is handed to the operating system at once, so that a killed process
    loses the messages since the last chunk or `flush` and nothing else. A failed write (a full
    disk) cuts the file back to its last whole chunk and closes it; what is there can be recovered.
    ``metadata.yaml`` is there if and only if all files in the folder are whole.

    Attributes:
        folder: Folder to create; the files in it have the same name and a number.
        compression: ``none``, ``lz4`` or ``zstd``, of whole chunks.
        chunk_size: Size at which a chunk is written, in bytes before compression.
        custom_data: Texts for the bag's metadata; may be filled until `close`.
        max_size: Size on the disk at which the next file is begun, in bytes; 0 for never.
        max_duration: Recorded time after which the next file is begun, in ns; 0 for never.
        earlier: Files and topics of a bag in the folder that is continued; the folder exists then.
        lazy: Whether the first file is created with the first message.
    """

    folder: Path
    compression: str = "none"
    chunk_size: int = CHUNK_SIZE
    custom_data: dict[str, str] = field(default_factory=dict)
    ros_distro: str = field(default_factory=lambda: os.environ.get("ROS_DISTRO") or "jazzy")
    max_size: int = 0
    max_duration: int = 0
    earlier: BagMetadata | None = None
    lazy: bool = False

    def __post_init__(self) -> None:
        """Create the folder and open the file.

        Raises:
            BagError: If the folder exists, cannot be created, or the compression is unknown.
        """
        self.folder = Path(self.folder)
        if self.compression not in COMPRESSIONS:
            raise BagError(
                f"Compression is '{self.compression}', expected one of {', '.join(COMPRESSIONS)}."
            )
        self._channels: list[_Channel] = []
        self._records: list[tuple[str, dict[str, str]]] = []
        self._files: list[FileMetadata] = list(self.earlier.files) if self.earlier else []
        self._file: BagFile | None = None
        self._closed = False
        self._finished_count = 0
        self.bytes_received = 0
        if self.earlier is None:
            _create(self.folder)
        if not self.lazy:
            self._open()

    def _open(self) -> BagFile:
        """Begin the next file, with all that was announced so far."""
        name = self.folder.resolve().name
        number = len(self._files)
        while (path := self.folder / f"{name}_{number}.mcap").exists():
            number += 1
        try:
            (self.folder / FILE_NAME).unlink(missing_ok=True)
            file = BagFile(path, self.compression, self.chunk_size)
            self._file = file
            file.add_metadata(RECORD_NAME, self.metadata().record())
            for record in self._records:
                file.add_metadata(*record)
            self._announce(file, self._channels)
        except OSError as error:
            raise self._failure(error) from error
        return file

    @staticmethod
    def _announce(file: BagFile, channels: Iterable[_Channel]) -> None:
        """Register channels, in the same order in every file so that their numbers are equal."""
        for channel in channels:
            definition = channel.definition
            schema = file.add_schema(
                channel.type_name, definition.encoding, definition.text.encode()
            )
            texts = {
                "offered_qos_profiles": qos_text(channel.offers),
                "topic_type_hash": channel.type_hash,
            }
            file.add_channel(channel.topic, "cdr", schema, texts)

    @property
    def path(self) -> Path:
        """The file in progress, or the last one."""
        return self._file.path if self._file else self.folder / self._files[-1].path

    @property
    def is_open(self) -> bool:
        """Whether messages are accepted."""
        return not self._closed

    @property
    def message_count(self) -> int:
        """Number of messages accepted so far."""
        return self._finished_count + (self._file.span.count if self._file else 0)

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
        definition = definition or message_definition(type_name)
        channel = _Channel(topic, type_name, tuple(offers), type_hash, definition)
        for known in self.earlier.topics if self.earlier else ():
            # Readers take a topic with other offers in a later file for another topic.
            if (known.name, known.type) == (topic, type_name):
                channel.offers = known.offered_qos_profiles
                channel.type_hash = known.type_description_hash
        if self._file is not None:
            self._guard(self._announce, self._file, [channel])
        self._channels.append(channel)
        return len(self._channels)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to every MCAP file, which any MCAP reader shows.

        Args:
            name: Name of the record.
            values: Its texts by key.

        Raises:
            BagError: If the bag is closed or the disk refuses the data.
        """
        self._check_open()
        self._records.append((name, dict(values)))
        if self._file is not None:
            self._guard(self._file.add_metadata, name, dict(values))

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
        file = self._file or self._open()
        try:
            file.write(channel, data, log_time, publish_time)
        except OSError as error:
            raise self._failure(error) from error
        self._channels[channel - 1].count += 1
        self.bytes_received += len(data)
        if self._is_full(file):
            self.split()

    def _is_full(self, file: BagFile) -> bool:
        if self.max_size and file.size >= self.max_size:
            return True
        return bool(self.max_duration and file.span.end - file.span.start >= self.max_duration)

    def flush(self) -> None:
        """Finish the chunk in progress, so that its messages survive the death of the process.

        Raises:
            BagError: If the disk refuses the data.
        """
        if self._file is not None and self.is_open:
            self._guard(self._file.flush)

    def split(self) -> None:
        """Finish the present file; the next message begins another one.

        Raises:
            BagError: If the disk refuses the data.
        """
        if self._file is None:
            return
        file, metadata = self._file, self.metadata()
        self._guard(file.flush)
        self._guard(file.add_metadata, RECORD_NAME, metadata.record())
        self._guard(file.finish)
        self._finished_count += file.span.count
        self._files.append(file.metadata)
        self._file = None

    def checkpoint(self) -> BagMetadata:
        """Finish the present file and make the folder a whole bag, which may still go on.

        Raises:
            BagError: If the disk refuses the data.
        """
        self.split()
        metadata = self.metadata()
        self._write_metadata(metadata.file_text())
        return metadata

    def close(self) -> BagMetadata:
        """Write index and metadata; repeated calls change nothing.

        Returns:
            The metadata that was written.

        Raises:
            BagError: If the disk refuses the data.
        """
        if self._closed:
            return self.metadata()
        if self._file is None and not self._files:
            self._open()
        metadata = self.checkpoint()
        self._closed = True
        return metadata

    def _write_metadata(self, text: str) -> None:
        """Write ``metadata.yaml`` whole or not at all."""
        try:
            replace_text(self.folder / FILE_NAME, text)
        except OSError as error:
            raise self._failure(error) from error

    def metadata(self) -> BagMetadata:
        """Return what is known of the bag now; topics in order of their names."""
        earlier = self.earlier.topics if self.earlier else ()
        files = [*self._files, *([self._file.metadata] if self._file else [])]
        return BagMetadata(
            files=files,
            topics=merge_topics([*earlier, *(channel.metadata() for channel in self._channels)]),
            custom_data=self.custom_data,
            ros_distro=self.ros_distro,
        )

    def counts(self) -> Mapping[str, int]:
        """Return the number of messages by topic."""
        return {channel.topic: channel.count for channel in self._channels}

    def _check_open(self) -> None:
        if self._closed:
            raise BagError(f"The bag {self.folder} is closed, nothing can be added to it.")

    def _guard(self, call: Callable[..., Any], *args: Any) -> Any:
        try:
            return call(*args)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> BagError:
        """Close the bag at its last whole record."""
        if self._file is not None:
            self._file.abandon()
            self._files.append(self._file.metadata)
            self._finished_count += self._file.span.count
            self._file = None
        count = self._finished_count
        self._closed = True
        return BagError(
            f"The bag {self.folder} could not be written: {error.strerror or error}; recording "
            f"ended after {count} messages, free some space and run "
            f"`tactile-hand recover {self.folder}`."
        )

    def __enter__(self) -> BagWriter:
        """Return the open writer."""
        return self

    def __exit__(self, *_: object) -> None:
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
