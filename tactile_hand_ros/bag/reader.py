# SPDX-License-Identifier: Apache-2.0
"""Reading of bags: a thin layer on top of rosbags, with errors that state the remedy."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from tactile_hand_ros.bag.metadata import FILE_NAME, RECORD_KEY, RECORD_NAME
from tactile_hand_ros.errors import BagError

_BAGS = (".mcap", ".db3")


class RecordedMessage(NamedTuple):
    """The recorded bytes of one message; log time in ns since the epoch."""

    topic: str
    log_time: int
    data: bytes
    type: str

    @property
    def message(self) -> Any:
        """The decoded message; raises `BagError` like `decode`."""
        return decode(self.type, self.data)


@dataclass(frozen=True)
class BagSummary:
    """Contents of a bag; its start in ns since the epoch, None without messages."""

    counts: dict[str, int]
    types: dict[str, str]
    start_time: int | None
    custom_data: dict[str, str]

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(self.counts.values())


def find_bag(path: Path) -> Path:
    """Return the bag at a path: the path itself, or ``bag/`` in the folder of a run.

    Raises:
        BagError: If it does not exist.
    """
    if not path.exists():
        raise BagError(f"The run or bag {path} does not exist; check the path.")
    if (path / "bag").exists():
        return path / "bag"
    if (path / "scenario.yaml").exists():
        raise BagError(f"The run {path} has no folder bag/; it was never recorded.")
    return path


@contextlib.contextmanager
def open_bag(path: Path | str) -> Iterator[AnyReader]:
    """Open a run with ``bag/`` in it, a bag folder, or a single ``.mcap`` or ``.db3`` file.

    Raises:
        BagError: If it is missing, empty, truncated or damaged.
    """
    path = find_bag(Path(path))
    if path.is_dir() and not (path / FILE_NAME).exists():
        raise BagError(
            f"The folder {path} has no {FILE_NAME}: it is not a bag, or its recording was cut off "
            f"or is still running; run `tactile-hand recover {path}`."
        )
    with _damage_refused(path):
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


def summarize(path: Path | str) -> BagSummary:
    """Return topics, message counts and times of a bag; raise BagError like `open_bag`."""
    # rosbags does not check the types of values in metadata.yaml.
    with open_bag(path) as reader, _damage_refused(path):
        counts: dict[str, int] = {}
        for connection in reader.connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + int(connection.msgcount)
        custom = dict(_custom_data(reader, Path(path)))
        return BagSummary(
            counts=counts,
            types={each.topic: str(each.msgtype) for each in reader.connections},
            start_time=int(reader.start_time) if reader.message_count else None,
            custom_data={str(key): str(text) for key, text in custom.items()},
        )


def read_messages(
    path: Path | str, topics: Collection[str] | None = None
) -> Iterator[RecordedMessage]:
    """Yield the messages of topics (full names; all if None) in order of log time.

    It raises BagError like `open_bag`, as does `read_topics`.
    """
    with open_bag(path) as reader:
        chosen = [c for c in reader.connections if topics is None or c.topic in topics]
        for connection, log_time, data in iterate(reader, chosen):
            yield RecordedMessage(connection.topic, log_time, bytes(data), connection.msgtype)


class TopicMessages(NamedTuple):
    """The messages of one topic in order of log time, ns since the epoch."""

    log_times: list[int]
    data: list[bytes]

    def part(self, start: int, stop: int) -> TopicMessages:
        """Return the messages of a range of indices."""
        return TopicMessages(self.log_times[start:stop], self.data[start:stop])


def read_topics(path: Path | str, topics: Collection[str]) -> dict[str, TopicMessages]:
    """Read all messages of topics, given by full names; absent topics have no messages."""
    found = {topic: TopicMessages([], []) for topic in topics}
    for message in read_messages(path, topics):
        found[message.topic].log_times.append(message.log_time)
        found[message.topic].data.append(message.data)
    return found


def decode(type_name: str, data: bytes) -> Any:
    """Return a message of a type that is part of ROS 2 Jazzy.

    Raises:
        BagError: If it is not of that type.
    """
    try:
        return get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, type_name)
    except Exception as error:  # damaged data can fail anywhere in the parsers
        raise BagError(
            f"A message is not a valid {type_name}: {error}; record it again."
        ) from error


def iterate(
    reader: AnyReader, connections: Sequence[Connection]
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, log time [ns] and data of messages in order of log time.

    Raises:
        BagError: If the bag is damaged.
    """
    if connections:  # with an empty list, rosbags yields all messages
        with _damage_refused(str(reader.paths[0])):
            yield from reader.messages(connections)


@contextlib.contextmanager
def _damage_refused(path: Path | str) -> Iterator[None]:
    """Turn parser errors into `BagError`, because damaged data can fail anywhere in them."""
    try:
        yield
    except BagError:
        raise
    except PermissionError as error:
        raise BagError(
            f"The bag {path} cannot be read: {error.strerror}; check its mode."
        ) from None
    except Exception as error:
        reason = str(error).rstrip(".") or type(error).__name__
        if Path(path).is_file() and Path(path).suffix not in _BAGS:
            raise BagError(
                f"{path} is not a bag; give the folder of a run, a bag folder, or a file that ends "
                f"in {' or '.join(_BAGS)}."
            ) from error
        raise BagError(
            f"The bag {path} is empty, cut off or damaged ({reason[:200]}); "
            f"run `tactile-hand recover {path}`."
        ) from error


def _custom_data(reader: AnyReader, path: Path) -> dict[str, str]:
    """Return the custom data of a bag; a single file has no metadata.yaml next to it."""
    parts = [part.storage for part in reader.readers if isinstance(part, Reader)]
    found = next((part.metadata.custom for part in parts if part.metadata.custom), {})
    if found or path.is_dir() or path.suffix != ".mcap":
        return found
    with path.open("rb") as file:
        inside = make_reader(file).iter_metadata()
        texts = [each.metadata[RECORD_KEY] for each in inside if each.name == RECORD_NAME]
    return yaml.safe_load(texts[-1]).get("custom_data") or {} if texts else {}
