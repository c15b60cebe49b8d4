# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 folder with one MCAP file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from tactile_hand_ros.bag.metadata import (
    FILE_NAME,
    NO_START,
    RECORD_NAME,
    BagMetadata,
    OfferedQos,
    TopicMetadata,
    dump,
)
from tactile_hand_ros.bag.schema import MessageDefinition, message_definition
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.files import replace_text

CHUNK_SIZE = 2**20  # bytes
LIBRARY = "tactile_hand_ros"


@dataclass
class BagWriter:
    """Writes serialized messages to a new bag in the format of rosbag2 (Jazzy).

    A killed process loses the messages since the last `flush`. ``metadata.yaml`` exists if and only
    if the bag is complete. After a failed write (a full disk) the bag is closed; the data on disk
    can be recovered. All methods raise BagError if a write fails or the bag is closed.

    Attributes:
        folder: Folder to create; its file has the same name.
        compression: Compression of the chunks: ``none``, ``lz4`` or ``zstd``.
        chunk_size: Size of a chunk before compression [B].
        custom_data: Texts for the bag's metadata; may be changed until `close`.
    """

    folder: Path
    compression: str = "none"
    chunk_size: int = CHUNK_SIZE
    custom_data: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Create folder and file.

        Raises:
            BagError: If the folder exists or cannot be created.
        """
        self.path = self.folder / f"{self.folder.resolve().name}_0.mcap"
        try:
            self.folder.mkdir(parents=True)
            self._file = self.path.open("xb")
        except FileExistsError:
            raise BagError(
                f"The output {self.folder} exists already, expected a new folder; choose another "
                "name or remove it."
            ) from None
        except OSError as error:
            raise BagError(
                f"The output {self.folder} cannot be created: {error.strerror}; choose a writable "
                "folder."
            ) from None
        self.is_open = True
        self._start, self._end = NO_START, 0
        self._topics: list[TopicMetadata] = []
        self._schemas: dict[tuple[str, MessageDefinition], int] = {}
        self._writer = Writer(
            self._file,
            chunk_size=self.chunk_size,
            compression=CompressionType[self.compression.upper()],
        )
        self._do(self._writer.start, "ros2", LIBRARY)
        self.add_metadata(RECORD_NAME, self.metadata().record())
        self.flush()

    def add_channel(
        self,
        topic: str,
        type_name: str,
        *,
        offers: Sequence[OfferedQos] = (),
        type_hash: str = "",
        definition: MessageDefinition | None = None,
    ) -> int:
        """Announce a topic and return its channel number for `write`, counted from 1.

        Args:
            topic: Full name.
            type_name: Full name of the type, e.g. ``std_msgs/msg/String``.
            offers: QoS profiles that its publishers offer.
            type_hash: Hash of the type, ``RIHS01_...``.
            definition: Schema; by default that of the installed package.

        Raises:
            BagError: If the type's definition is not installed.
        """
        key = type_name, definition or message_definition(type_name)
        if key not in self._schemas:
            name, schema = key
            register = self._writer.register_schema
            self._schemas[key] = self._do(register, name, schema.encoding, schema.text.encode())
        texts = {"offered_qos_profiles": dump(list(offers)), "topic_type_hash": type_hash}
        self._do(self._writer.register_channel, topic, "cdr", self._schemas[key], texts)
        self._topics.append(TopicMetadata(topic, type_name, tuple(offers), type_hash))
        return len(self._topics)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to the MCAP file, which any MCAP reader shows."""
        self._do(self._writer.add_metadata, name, dict(values))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int) -> None:
        """Append one CDR message, with times of reception and publication in ns since the epoch."""
        self._do(self._writer.add_message, channel, log_time, data, publish_time)
        self._topics[channel - 1].message_count += 1
        self._start = min(self._start, log_time)
        self._end = max(self._end, log_time)

    def flush(self) -> None:
        """Finish the current chunk, so that its messages survive a crash of the process."""
        self._do(self._writer.flush)

    def close(self) -> BagMetadata:
        """Write index and metadata, and return the metadata; repeated calls change nothing."""
        metadata = self.metadata()
        if self.is_open:
            self.flush()
            self.add_metadata(RECORD_NAME, metadata.record())
            self._do(self._writer.finish)
            self._do(self._file.close)
            self._do(replace_text, self.folder / FILE_NAME, metadata.file_text())
            self.is_open = False
        return metadata

    def metadata(self) -> BagMetadata:
        """Return the current metadata, with topics sorted by name."""
        return BagMetadata(
            path=self.path.name,
            start=self._start,
            duration=max(0, self._end - self._start),
            topics=sorted(self._topics, key=lambda topic: topic.name),
            custom_data=dict(self.custom_data),
        )

    def _do(self, call: Callable[..., Any], *args: Any) -> Any:
        """Call a writing function; close the bag if it fails."""
        if not self.is_open:
            raise BagError(f"The bag {self.folder} is closed; nothing can be added to it.")
        try:
            return call(*args)
        except OSError as error:
            self.is_open = False
            with contextlib.suppress(OSError):
                self._file.close()
            raise BagError(
                f"The bag {self.folder} could not be written: {error.strerror or error}; free some "
                f"space and run `tactile-hand recover {self.folder}`."
            ) from error

    def __enter__(self) -> BagWriter:
        """Return the open writer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag, also after an error, so that it stays readable."""
        self.close()
